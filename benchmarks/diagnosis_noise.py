"""Is the noise that diagnosis estimates the noise there is? Nulls of the concealed benchmark, simulated at their true numbers.

python benchmarks/concealed make --seeds development --strata null --cases 0-59 --work WORK
python benchmarks/diagnosis_noise.py WORK/development

For every null: |residual|^2 over its expectation at the true machine numbers, on the repeats' mean and on the held-out recording (1 is
right), and after re-tuning. Truths are read here, as only a development set's may be. Prints JSON.
"""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

import numpy as np

from hil.diagnosis.free_run import HELD_OUT, TRAIN, FreeRuns, Trial
from hil.diagnosis.mismatch import mismatch
from hil.diagnosis.retune import retune
from hil.machine import load_machine
from hil.recording import read_recording


def true_values(runs: FreeRuns, factors: dict[str, float]) -> np.ndarray:
    """Plant parameters of the truth: `mass:boom` is a factor on that body's mass."""
    values = runs.nominal
    for key, factor in factors.items():
        quantity, owner = key.split(":")
        for k, parameter in enumerate(runs.parameters):
            if parameter.owner == owner and parameter.quantity.startswith(quantity):
                values[k] *= factor
    return values


def judged(case: Path, truth: dict) -> dict[str, object]:
    """One null."""
    machine = load_machine(case / "machine.toml")
    train = mismatch(machine, {path.stem: read_recording(path, machine) for path in sorted(case.glob("run_*.csv"))})
    held = {path.stem: read_recording(path, machine) for path in sorted(case.glob("held_out*.csv"))}
    sets = {TRAIN: train, HELD_OUT: mismatch(machine, held, channels=train.channels, noise=train.noise)}
    runs = FreeRuns(sets, train.noise)
    tuning = retune(runs)
    at_truth = Trial(true_values(runs, truth["factors"]))
    ratios = {}
    for name, trial in (("true", at_truth), ("retuned", Trial(tuning.values))):
        for part in (TRAIN, HELD_OUT):
            answer = runs.run_one(trial, part)
            ratios[f"{name}_{part}"] = None if answer is None else round(float(np.mean((runs.measured(part) - answer) ** 2)), 3)
    return {"case": case.name, "machine": truth["machine"], "colour": truth["colour"], **ratios}


def main(folder: Path) -> None:
    """Print a line per null of a set, then the median and range over them."""
    warnings.simplefilter("ignore")
    found = []
    for case in sorted((folder / "cases").iterdir()):
        truth = json.loads((folder / "truths" / f"{case.name}.json").read_text())
        if truth["stratum"] == "null" and truth["machine"] != "carm":
            found.append(judged(case, truth))
            print(json.dumps(found[-1]), flush=True)
    for key in ("true_train", "true_held_out", "retuned_train", "retuned_held_out"):
        ratios = [entry[key] for entry in found if entry[key] is not None]
        print(json.dumps({key: {"median": float(np.median(ratios)), "least": min(ratios), "most": max(ratios), "nulls": len(ratios)}}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
