"""Keep the table of `isocenter faults check` for the pages, without what differs from computer to computer.

isocenter faults check carm -o faults
python benchmarks/fault_table.py faults
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

VERDICTS = ("stopped", "noted", "unnoticed", "cannot be held", "not at rest", "never began", "did not end")
SAID = 220  # characters


def main() -> None:
    """Write benchmarks/results/faults_MACHINE.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("folder", type=Path, help="that `faults check` wrote")
    table = json.loads((parser.parse_args().folder / "faults.json").read_text(encoding="utf-8"))
    counts = Counter(row["verdict"] for row in table["faults"])
    rows = [
        {
            "name": row["name"],
            "verdict": row["verdict"],
            "rest_s": row["rest_s"] if row["rest_s"] is None else round(row["rest_s"], 3),
            "travel": row["travel"] if row["travel"] is None else round(row["travel"], 4),
            "ending": row["ending"],
            "said": row["said"] if len(row["said"]) <= SAID else row["said"][: SAID - 1] + "…",
        }
        for row in table["faults"]
    ]
    kept = {key: table[key] for key in ("machine", "axis", "speed", "unit")}
    path = Path(__file__).parent / "results" / f"faults_{table['machine']}.json"
    document = {**kept, "faults": len(rows), "verdicts": {verdict: counts[verdict] for verdict in VERDICTS}, "rows": rows}
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(f"{path}: {len(rows)} faults")


if __name__ == "__main__":
    main()
