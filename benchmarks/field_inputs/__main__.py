"""Inputs of five kinds that people bring, made here with known content: right, refused with the way out, or wrong.

python benchmarks/field_inputs
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from field_inputs import disorder, geometry, lines, sheets, units, wrong_files
from field_inputs.kinds import RIGHT, WAY_OUT, WRONG, Input, Outcome

RESULTS = Path(__file__).resolve().parents[1] / "results" / "field_inputs.json"
INPUTS = [*disorder.INPUTS, *sheets.INPUTS, *wrong_files.INPUTS, *lines.INPUTS, *units.INPUTS, *geometry.INPUTS]
assert len({(one.kind, one.name) for one in INPUTS}) == len(INPUTS), "names are unique"


def judged(one: Input) -> Outcome:
    """Make an input and say what became of it; a traceback is wrong."""
    with tempfile.TemporaryDirectory(prefix="field-inputs-") as name:
        try:
            return one.judge(Path(name))
        except Exception as fault:
            return Outcome(WRONG, f"a traceback: {fault!r}")


def main() -> None:
    """Judge all of them and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="OUT", help="results")
    arguments = parser.parse_args()
    kinds: dict[str, Counter[str]] = {}
    inputs = {}
    for one in INPUTS:
        outcome = judged(one)
        kinds.setdefault(one.kind, Counter())[outcome.what] += 1
        inputs[f"{one.kind}: {one.name}"] = {"tool": one.tool, "outcome": outcome.what}
        if outcome.what == WRONG:
            print(f"{one.kind}: {one.name}: {outcome.said}", flush=True)
    table = {
        kind: {"inputs": counts.total(), "right": counts[RIGHT], "refused": counts[WAY_OUT], "wrong": counts[WRONG]}
        for kind, counts in kinds.items()
    }
    total = {name: sum(row[name] for row in table.values()) for name in ("inputs", "right", "refused", "wrong")}
    print(json.dumps(total))
    arguments.json.write_text(json.dumps({"total": total, "kinds": table, "inputs": inputs}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
