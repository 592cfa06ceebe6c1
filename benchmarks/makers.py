"""Drives of five makers, by their own data sheets unchanged, on the emulated C-arm: to a pose in every mode that their objects carry.

The bench knows the devices from these files alone; the emulated drives behave as their files' objects allow. The data sheets are not part
of the project: they lie in a folder beside it.

    python benchmarks/makers.py ../shared/data/canopen
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from other_makers import FILES, NEEDS, carm_text_with, modes_of

from drivers.errors import DriverError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import BenchError
from hil.machine import machine_from_text

RESULTS = Path(__file__).parent / "results" / "makers.json"
GOAL = np.radians([-5.0, 10.0])
NOT_THERE = "no such mode"


def moved(file: Path, mode: str) -> dict[str, object]:
    """Go to the pose; return how far from it the axes stand in the end, or why they do not."""
    try:
        with open_bench(machine_from_text(carm_text_with(file, mode)), BenchOptions("lockstep:")) as bench:
            return {"moved": "yes", "off_mrad": round(1e3 * float(np.abs(bench.move(GOAL) - GOAL).max()), 3)}
    except (DriverError, BenchError) as error:
        return {"moved": f"no: {str(error).splitlines()[0]}"}


def main() -> None:
    """Try every maker in every mode."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with the data sheets")
    folder = parser.parse_args().folder.resolve()
    warnings.simplefilter("ignore")  # of repairs
    results = {}
    for maker, name in FILES.items():
        has = modes_of(folder / name)
        results[maker] = {mode: moved(folder / name, mode) if mode in has else {"moved": NOT_THERE} for mode in NEEDS}
        print(maker, results[maker], flush=True)
    RESULTS.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
