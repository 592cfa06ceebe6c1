"""Is the noise that diagnosis estimates the noise there is? Nulls of the concealed benchmark, simulated at their true numbers.

python benchmarks/concealed make --seeds development --strata null --cases 0-59 --work WORK
python benchmarks/diagnosis_noise.py WORK/development
python benchmarks/diagnosis_noise.py WORK/development --machine carm
python benchmarks/diagnosis_noise.py WORK/development --along 45,48,15
python benchmarks/diagnosis_noise.py WORK/development --gate 45,48,15

For every null: |residual|^2 over its expectation at the true machine numbers, on the repeats' mean and on the held-out recording (1 is
right), after re-tuning, and held out where the machine's numbers follow; and how far re-tuning's cost is below that of the true numbers, by
chance about as much as there are numbers: less than nothing, and it has stopped short. With --machine, those of this machine alone. With
--along, for these nulls: the variance, in units of the noise model's, of twelve fresh repeats and of the
recorded ones, each about their mean, along what every candidate changes, re-tuning projected out; 1 is right. With --gate, for these nulls:
the least expected number of tried sets that gain as much in training by chance (of independent candidates, below a in about a share a of
them), the farthest that held-out recordings follow a set (root of the misfit's fall, in standard deviations), the least chance of both,
and the verdict; then shares, and the likeliest scale of the t distribution of what follows. Truths are read here, as only a development
set's may be. Prints JSON.
"""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

import numpy as np
import scipy.optimize
import scipy.stats
from concealed import making
from concealed.truth.workshop import Workshop

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.fitting.screening import screen
from hil.diagnosis.judging.gate import HELD_OUT_FREEDOM
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.searching.bounded_noise import candidates_for
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import retune
from hil.machine import load_machine
from hil.recording import read_recording

FRESH = range(600, 612)
"""Repeats that no case holds."""


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
    ratios, costs = {}, {}
    offsets = {"true": (at_truth.values - runs.nominal)[tuning.indices] / tuning.scale, "retuned": tuning.offset}
    for name, trial in (("true", at_truth), ("retuned", Trial(tuning.values))):
        for part in (TRAIN, HELD_OUT):
            answer = runs.run_one(trial, part)
            energy = np.inf if answer is None else float(np.sum((runs.measured(part) - answer) ** 2))
            ratios[f"{name}_{part}"] = None if answer is None else round(energy / len(runs.measured(part)), 4)
            if part == TRAIN:
                costs[name] = energy + float(offsets[name] @ offsets[name])
    judge = HeldOut(runs, tuning)
    ratios["followed_held_out"] = round(judge.misfit(judge.follow(tuning.offset, ())) / len(judge.measured), 4)
    row = {"case": case.name, "machine": truth["machine"], "colour": truth["colour"], "experiment": truth["training"]}
    return row | ratios | {"numbers": len(tuning.offset), "below_truth": round(costs["true"] - costs["retuned"], 1)}


def along(folder: Path, number: int) -> dict[str, object]:
    """One null's noise along the candidates' responses."""
    places = making.Places(folder.parent, folder.name)
    making.make(places, number)
    machine = load_machine(places.case(number) / "machine.toml")
    train = mismatch(machine, {path.stem: read_recording(path, machine) for path in sorted(places.case(number).glob("run_*.csv"))})
    case = making.case_of(places, number)
    shop = Workshop(case, making.machines(places.models)[case.machine])
    nothing = shop.setup(())
    group = train.groups[0]
    drawn = [shop.recorded(nothing, shop.training, repeat).channels for repeat in FRESH]
    repeats = {"fresh": np.stack([np.column_stack([one[name] for name in train.channels])[: len(group.mean)] for one in drawn])}
    repeats["own"] = group.complete
    deviations = {
        name: [train.noise.whiten(rows, group.imu) for rows in (some - some.mean(axis=0)) * np.sqrt(len(some) / (len(some) - 1.0))]
        for name, some in repeats.items()
    }
    runs = FreeRuns({TRAIN: train}, train.noise)
    tuning = retune(runs)
    projection = Projection.of(tuning)
    found = screen(runs, tuning, candidates_for(runs, tuning)(None), runs.measured() - tuning.predicted)
    variances: dict[str, list[float]] = {"fresh": [], "own": []}
    for screened in found:
        response = screened.response.astype(float)
        size = np.linalg.norm(response)
        if size > 0.0:
            for name, whitened in deviations.items():
                left = [projection.left(one) @ response / size for one in whitened]
                variances[name].append(float(np.mean(np.square(left))))
    answer: dict[str, object] = {"case": number, "machine": case.machine, "colour": case.colour, "repeats": group.repeats}
    for name, values in variances.items():
        numbers = {"mean": np.mean(values), "median": np.median(values), "most": max(values)}
        answer[name] = {key: round(float(value), 2) for key, value in numbers.items()}
    return answer


def gates(folder: Path, numbers: list[int]) -> None:
    """Print what the gate sees on these nulls."""
    rows, followed = [], []
    for number in numbers:
        case = folder / "cases" / f"{number:04d}"
        assert json.loads((folder / "truths" / f"{number:04d}.json").read_text())["stratum"] == "null", f"case {number} hides something"
        machine = load_machine(case / "machine.toml")
        runs, held = (
            {path.stem: read_recording(path, machine) for path in sorted(case.glob(f"{part}*.csv"))} for part in ("run_", "held_out")
        )
        outcome = diagnose(machine, runs, held, look_further=False)
        asked = [contender.gate for contender in outcome.selection.contenders if contender.gate.is_first]
        falls = [float(np.sqrt(max(gate.held_out_gain or 0.0, 0.0) / gate.scatter)) for gate in asked]
        followed += falls
        least = {key: min((getattr(gate, key) for gate in asked), default=1.0) for key in ("trained", "chance")}
        rows.append({"number": number, **least, "follow": max(falls, default=0.0), "verdict": outcome.diagnosis.verdict})
        print(json.dumps(rows[-1]), flush=True)
    found, near = np.array(followed), 0.5

    def cost(log_scale: float) -> float:
        scale, far = np.exp(log_scale), found > near
        beyond = np.sum(scipy.stats.t.logpdf(found[far] / scale, HELD_OUT_FREEDOM) - log_scale)
        return float(-beyond - np.sum(~far) * scipy.stats.t.logcdf(near / scale, HELD_OUT_FREEDOM))

    scale = float(np.exp(scipy.optimize.minimize_scalar(cost, bounds=(-2.0, 1.0), method="bounded").x))
    shares = {key: {str(a): float(np.mean([row[key] < a for row in rows])) for a in (0.1, 0.3, 1.0)} for key in ("trained", "chance")}
    print(json.dumps({"nulls": len(rows), "sets": len(found), "scale": scale, "beyond_2.5": float(np.mean(found > 2.5)), **shares}))


def main(folder: Path, machine: str = "") -> None:
    """Print a line per null of a set, of one machine where it is named, then the median and range over them."""
    warnings.simplefilter("ignore")
    found = []
    for case in sorted((folder / "cases").iterdir()):
        truth = json.loads((folder / "truths" / f"{case.name}.json").read_text())
        if truth["stratum"] == "null" and truth["machine"].startswith(machine):
            found.append(judged(case, truth))
            print(json.dumps(found[-1]), flush=True)
    for key in ("true_train", "true_held_out", "retuned_train", "retuned_held_out", "followed_held_out"):
        ratios = [entry[key] for entry in found if entry[key] is not None]
        print(json.dumps({key: {"median": float(np.median(ratios)), "least": min(ratios), "most": max(ratios), "nulls": len(ratios)}}))


if __name__ == "__main__":
    if "--along" in sys.argv:
        warnings.simplefilter("ignore")
        for number in sys.argv[sys.argv.index("--along") + 1].split(","):
            print(json.dumps(along(Path(sys.argv[1]), int(number))), flush=True)
    elif "--gate" in sys.argv:
        warnings.simplefilter("ignore")
        gates(Path(sys.argv[1]), [int(number) for number in sys.argv[sys.argv.index("--gate") + 1].split(",")])
    else:
        main(Path(sys.argv[1]), sys.argv[sys.argv.index("--machine") + 1] if "--machine" in sys.argv else "")
