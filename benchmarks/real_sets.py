"""What is named on recordings that other people measured, beside an engineer's fit of each set.

`python benchmarks/real_sets.py [SET...] [--splits WORDS] [--json FILE]`: for every set and split, what is named, how its rivals stand, and
the errors of the nominal machine and of the answer on training and held-out parts, by the engineer's metric, beside the engineer's own
(benchmarks/experts). A split whose result is kept is not run again: delete it from the file to have it run.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from real_data import DATA

from hil.diagnosis.named.naming import Named, name
from hil.diagnosis.predicted.refitting import refitted
from hil.diagnosis.seen.see import see
from virtual_bus.settings import EffectSetting

RESULTS = Path(__file__).resolve().parent / "results"
SETS = (
    "emps", "silverbox", "coupled_electric_drives", "laas_anti_cogging", "dfki_double_pendulum", "bam_xl330", "ur5", "tx40", "dpend",
    "damiao",
)  # fmt: skip
RANKS = 3


def words(settings: tuple[EffectSetting, ...]) -> list[str]:
    """Return effects with their places and parameters."""
    return [
        f"{each.name} at {each.at}: " + ", ".join(f"{key} {value:.4g}" for key, value in each.parameters.items() if value)
        for each in settings
    ]


def entry(named: Named, errors: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Return what the results hold of one split."""
    best = named.ranked[0]
    numbers = {key: float(np.round(value, 2)) for key, value in zip(named.tuned.numbers.names, named.best.offset, strict=False) if value}
    return {
        "named": words(named.best.settings),
        "likeliest in the fast view": [
            {"effects": words(each.fitted.settings), "behind": round(each.cost - best.cost, 1)} for each in named.ranked[:RANKS]
        ],
        "numbers in standard deviations of their prior": numbers,
        "scatter": round(best.dispersion, 2),
        "channels": errors,
        "seconds": round(seconds, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", choices=[*SETS, []], help="which sets; all by default")
    parser.add_argument("--splits", default="", help="only splits whose name has these words")
    parser.add_argument("--json", type=Path, default=RESULTS / "real_sets.json")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} is not here: these recordings are not part of the project")
    results = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    for of in arguments.sets or SETS:
        module = importlib.import_module(f"real.{of}")
        for split, data in module.splits().items():
            if arguments.splits not in split or split in results.get(of, {}):
                continue
            begun = time.monotonic()
            named = refitted(name(see(data.machine, data.train)))
            seconds = time.monotonic() - begun
            values = named.tuned.numbers.values(named.best.offset[: len(named.tuned.numbers.indices)])
            answers = {"nominal": (None, ()), "answer": (values, named.best.settings)}
            errors: dict[str, dict[str, Any]] = {}
            for stage, (numbers, settings) in answers.items():
                for channel, found in module.errors(split, data.machine, numbers, settings).items():
                    errors.setdefault(channel, {})[stage] = {part: float(f"{value:.4g}") for part, value in found.items()}
            results.setdefault(of, {})[split] = entry(named, errors, seconds)
            arguments.json.write_text(json.dumps(results, indent=1) + "\n")
            print(f"{of}, {split}: {'; '.join(results[of][split]['named']) or 'nothing'} ({seconds:.0f} s)")
            for channel, found in errors.items():
                print("  " + channel + ": held out " + ", ".join(f"{stage} {value['held_out']}" for stage, value in found.items()))


if __name__ == "__main__":
    main()
