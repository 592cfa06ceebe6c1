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


def table(results: dict[str, Any]) -> dict[str, Any]:
    """Return for every set and split what was named, and its largest held-out error over the nominal machine's and the engineer's."""
    rows = {}
    for of, splits in results.items():
        experts = json.loads((RESULTS / "experts" / f"{of}.json").read_text())["splits"]
        for split, found in splits.items():
            expert = experts.get(split) or experts[split.rsplit(",", 1)[0]]  # an engineer's split may hold several machines
            over: dict[str, list[float]] = {"nominal": [], "engineer": []}
            for channel, stages in found["channels"].items():
                answer = stages["answer"]["held_out"]
                over["nominal"].append(answer / stages["nominal"]["held_out"])
                own = expert["channels"].get(channel, {}).get("fitted", {}).get("held_out")
                if own:
                    over["engineer"].append(answer / own)
            named = "; ".join(each.split(":")[0].replace("_", " ") for each in found["named"]) or "nothing"
            largest = {key: float(f"{max(values):.3g}") if values else None for key, values in over.items()}
            rows[f"{of}, {split}"] = {"named": named, **largest, "seconds": found["seconds"]}
    return rows


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
            arguments.json.with_stem(f"{arguments.json.stem}_table").write_text(json.dumps(table(results), indent=1) + "\n")
            print(f"{of}, {split}: {'; '.join(results[of][split]['named']) or 'nothing'} ({seconds:.0f} s)")
            for channel, found in errors.items():
                print("  " + channel + ": held out " + ", ".join(f"{stage} {value['held_out']}" for stage, value in found.items()))


if __name__ == "__main__":
    main()
