"""What is named on recordings that other people measured, beside an engineer's fit of each set.

`python benchmarks/real_sets.py [SET...] [--splits WORDS] [--free-runs] [--json FILE]`: for every set and split, what is named, how its
rivals stand, and the errors of the nominal machine and of the answer on training and held-out parts, by the engineer's metric, beside the
engineer's own (benchmarks/experts). With `--free-runs` sets are judged by free runs, as `diagnose` judges where it can. A split
whose result is kept is not run again: delete it from the file to have it run.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from real.common import ControllerSide
from real_data import DATA, RealSet

from controllers.settings import AxisController
from hil.diagnosis.model_choice.choose import Choice, choose_effects
from hil.diagnosis.prediction.refitting import refitted
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.selection.select import Selected, select
from hil.diagnosis.unknowns.unknowns import Machine as Trial
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


def entry(choice: Choice, errors: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Return what the results hold of one split."""
    best = choice.ranked[0]
    numbers = {key: float(np.round(value, 2)) for key, value in zip(choice.linear.numbers.names, choice.best.offset, strict=False) if value}
    return {
        "named": words(choice.best.settings),
        "likeliest in the fast view": [
            {"effects": words(each.fitted.settings), "behind": round(each.cost - best.cost, 1)} for each in choice.ranked[:RANKS]
        ],
        "numbers in standard deviations of their prior": numbers,
        "scatter": round(best.dispersion, 2),
        "channels": errors,
        "seconds": round(seconds, 1),
    }


Errors = dict[str, dict[str, float]]


def along_the_motion(module: ModuleType, split: str, data: RealSet) -> dict[str, Any]:
    """Return what the results hold of one split."""
    begun = time.monotonic()
    choice = refitted(choose_effects(residuals_of(data.machine, data.train)))
    seconds = time.monotonic() - begun
    values = choice.linear.numbers.values(choice.best.offset[: len(choice.linear.numbers.indices)])
    errors = {
        "nominal": module.errors(split, data.machine, None, ()),
        "answer": module.errors(split, data.machine, values, choice.best.settings),
    }
    return entry(choice, by_channel(errors), seconds)


def by_free_runs(module: ModuleType, split: str, data: RealSet) -> dict[str, Any]:
    """Return the same of the search that free runs judge, as far as they stay near the recordings."""
    begun = time.monotonic()
    found = select(data.machine, data.train)
    if found is None:
        return along_the_motion(module, split, data)
    seconds = time.monotonic() - begun
    machines = {"engineer's set": found.baseline, "answer": found.fit}
    errors = {"nominal": module.errors(split, data.machine, None, ())}
    errors |= {stage: with_side(module, split, data, found.unknowns.machine(fit.point)) for stage, fit in machines.items()}
    return entry_of(found, by_channel(errors), seconds)


def with_side(module: ModuleType, split: str, data: RealSet, trial: Trial) -> Errors:
    """Return the errors of a machine with what is said of its controller's side; when commands act is said by the metric's own loop."""
    machine, settings = data.machine, trial.effects
    if "side" in inspect.signature(module.errors).parameters:
        limit = dict(trial.speed_limit).get(0, np.inf)
        zero, lag = trial.effort_zero.get(0, 0.0), trial.effort_lag_s.get(0, 0.0)
        side = ControllerSide(float(trial.gain[0]), trial.lateness_s, zero, lag, limit)
        return dict(module.errors(split, machine, trial.values, settings, side=side))
    if machine.controllers:
        machine = replace(machine, controllers=tuple(with_gain(*each) for each in zip(machine.controllers, trial.gain, strict=True)))
    elif trial.lateness_s > 0.0 or getattr(module, "EFFORT_MAY_LEAD", False):
        settings = (*settings, *(EffectSetting("delay", axis, {"Td": trial.lateness_s}) for axis in machine.axes))
    return dict(module.errors(split, machine, trial.values, settings))


def with_gain(controller: AxisController, gain: float) -> AxisController:
    """Return a controller whose command is so many times as large: the first section of each chain has the gain."""

    def scaled(sections: Any) -> Any:
        if sections is None:
            return None
        first = sections[:1] * np.array([gain, gain, gain, 1.0, 1.0, 1.0])
        return np.vstack([first, sections[1:]])

    return replace(
        controller, position_sections=scaled(controller.position_sections), reference_sections=scaled(controller.reference_sections)
    )


def by_channel(errors: dict[str, Errors]) -> dict[str, Any]:
    """Return errors by channel, stage and part."""
    found: dict[str, dict[str, Any]] = {}
    for stage, channels in errors.items():
        for channel, parts in channels.items():
            found.setdefault(channel, {})[stage] = {part: float(f"{value:.4g}") for part, value in parts.items()}
    return found


def entry_of(found: Selected, errors: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Return what the results hold of one split."""
    point = found.fit.point
    numbers = {
        unknown.name: float(np.round(at, 2)) for unknown, at in zip(found.unknowns.each, point.numbers, strict=True) if abs(at) > 0.1
    }
    return {
        "named": words(point.settings),
        "numbers in standard deviations of their prior": numbers,
        "horizons_s": list(found.search.fitting.judge.horizons),
        "gain over the engineer's set": round(found.search.score(found.baseline) - found.search.score(found.fit), 1),
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
    parser.add_argument("--free-runs", action="store_true", help="judge sets of effects by free runs")
    parser.add_argument("--json", type=Path, help="result file")
    arguments = parser.parse_args()
    judge: Callable[[ModuleType, str, RealSet], dict[str, Any]] = by_free_runs if arguments.free_runs else along_the_motion
    arguments.json = arguments.json or RESULTS / ("real_sets_free_runs.json" if arguments.free_runs else "real_sets.json")
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} is not here: these recordings are not part of the project")
    results = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    for of in arguments.sets or SETS:
        module = importlib.import_module(f"real.{of}")
        for split, data in module.splits().items():
            if arguments.splits not in split or split in results.get(of, {}):
                continue
            answer = results.setdefault(of, {})[split] = judge(module, split, data)
            arguments.json.write_text(json.dumps(results, indent=1) + "\n")
            arguments.json.with_stem(f"{arguments.json.stem}_table").write_text(json.dumps(table(results), indent=1) + "\n")
            print(f"{of}, {split}: {'; '.join(answer['named']) or 'nothing'} ({answer['seconds']:.0f} s)")
            for channel, found in answer["channels"].items():
                print("  " + channel + ": held out " + ", ".join(f"{stage} {value['held_out']}" for stage, value in found.items()))


if __name__ == "__main__":
    main()
