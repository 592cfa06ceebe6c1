"""The concealed benchmark: make cases, run the tool on them, score its answers.

    python benchmarks/concealed make  --seeds development --cases 0-39
    python benchmarks/concealed run   --seeds development --cases 0-39 --jobs 2
    python benchmarks/concealed score --seeds development
    python benchmarks/concealed all   --seeds sealed --jobs 2
    python benchmarks/concealed mutate --seeds development --cases 1,12
    python benchmarks/concealed directions --seeds sealed --strata single,pair --cases 0-65
    python benchmarks/concealed tables --scores benchmarks/results/concealed/scores_sealed.json
    python benchmarks/concealed compare --trees COMMIT,COMMIT --seeds sealed --cases 0-749 --carm 60 --work WORK

Every step goes on where it was stopped. A case's folder holds recordings and the nominal machine file; truths lie apart and are opened by
`score` alone, after their SHA-256 was written beside the tool's answers (benchmarks/results/concealed/answers_SEEDS.jsonl).
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])
for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

from concealed.command import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
