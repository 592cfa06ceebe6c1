"""Whether the next experiment resolves what a diagnosis cannot tell apart: `python benchmarks/next_experiment.py [CASE...]`.

Every case hides an effect in the emulated turntable, as `isocenter run --effects` does in lockstep; besides, sixteen sines of other
frequencies and phases shake it in every run, which no effects file would take at one joint. Four runs of a slow jog and one of another,
held out, are diagnosed; as long as the verdict is `ambiguous`, the experiment that it writes is run three times and all recordings are
diagnosed again, twice at most. What the file predicts stands beside d as the recordings show it, with a sign: positive where the name that
was likeliest is nearer to them, negative where its rival is. Writes benchmarks/results/next_experiment.json.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.files import write_diagnosis
from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.retuning.linear_model import linear_at, nominal_offset
from hil.diagnosis.verdict.answer import NEXT_EXPERIMENT
from hil.diagnosis.verdict.values import Outcome
from hil.experiments import Experiment, Jog, JogOnly, read_experiment
from hil.machine import Machine, load_machine
from hil.recording import Recording, read_recording
from virtual_bus.settings import EffectSetting

RESULTS = Path(__file__).resolve().parent / "results" / "next_experiment.json"
TABLE = "turntable"
FIRST_SEEDS, HELD_OUT_SEED, NEXT_SEEDS = range(1, 5), 11, range(21, 24)
ROUNDS = 2
SHAKEN_BY, SHAKEN_Nm = 16, 0.02
"""Sines from 0.2 to 20 Hz at the joint: without them an emulated encoder shows the same lattice in every repeat and no noise."""

PLAUSIBLE = 0.04
TRAIN_deg, HELD_OUT_deg = 3.4, 2.6
CASES = {
    "stribeck_friction": {"Fs_minus_Fc": 0.3, "vs": 0.05, "delta": 2.0},
    "cable_spring": {"kc": 2.0, "kc3": 0.0, "theta0": 0.0},
    "gravity_imbalance": {"mgr": 1.5, "phi": 0.5},
    "coulomb_friction": {"Fc": 0.03},
    "position_dependent_friction": {"Fc": 0.3, "k": 2.0, "phi": 0.4},
    "cogging": {"Np": 12.0, "A1": 0.15, "phi1": 0.3, "A2": 0.0, "phi2": 0.0},
    "end_stop": {"K": 5.0, "D": 0.0, "at_position": 0.02, "side": 1.0},
    "pose_dependent_dynamics": {"dJ": 1.0, "phi": 0.4},
}
"""Hidden effects: in a slow jog of a few degrees each looks like another one, or may."""


def shaken(seed: int) -> list[EffectSetting]:
    """What disturbs one run."""
    random = np.random.default_rng(seed)
    frequencies = np.exp(random.uniform(math.log(0.2), math.log(20.0), SHAKEN_BY))
    phases = random.uniform(-math.pi, math.pi, SHAKEN_BY)
    return [
        EffectSetting("base_motion", "turn", {"A": SHAKEN_Nm, "f": float(f), "phi": float(phase)})
        for f, phase in zip(frequencies, phases, strict=True)
    ]


def record(machine: Machine, hidden: EffectSetting, seed: int, path: Path, experiment: Experiment) -> Recording:
    """One run with the hidden effect and the disturbance of a seed."""
    (plan,) = experiment.plans(machine)
    options = BenchOptions("lockstep:", seed=seed, emulated=machine.with_effects([hidden, *shaken(seed)]))
    with open_bench(machine, options, np.zeros(1)) as bench:  # commissioned where the hidden effect pulls little
        bench.run(plan, path)
    return read_recording(path, machine)


def jog(amplitude_deg: float) -> Experiment:
    """A slow sine about the middle: one period, after one to settle."""
    return JogOnly(pose={}, jog=Jog(math.radians(amplitude_deg), line=1), period_s=4.0, periods=1, settle_periods=1)


def said(outcome: Outcome) -> dict[str, Any]:
    """Verdict and plausible hypotheses."""
    hypotheses = [
        {"effects": [str(effect) for effect in h.effects], "confidence": round(h.confidence, 3)}
        for h in outcome.diagnosis.hypotheses
        if h.confidence >= PLAUSIBLE
    ]
    return {"verdict": outcome.diagnosis.verdict, "hypotheses": hypotheses}


def shown_by(outcome: Outcome, machine: Machine, recordings: Mapping[str, Recording]) -> list[float]:
    """Separations of the proposal's rivals that repeats of its experiment show: of their mean, over the root of their number."""
    assert outcome.proposal is not None
    seen = residuals_of(machine, recordings)
    offset = nominal_offset(seen.trajectories)
    first, *rivals = outcome.proposal.models
    offset[: len(first.offset)] = first.offset
    tuned = linear_at(seen.trajectories, seen.levels, offset, first.effects)
    costs = [fitted.cost() if (fitted := fit(tuned, model.effects, offset)) is not None else math.nan for model in (first, *rivals)]
    excess = (np.array(costs[1:]) - costs[0]) / len(recordings)
    return [float(d) for d in np.sign(excess) * np.sqrt(np.abs(excess))]


def circle(machine: Machine, name: str, folder: Path) -> dict[str, Any]:
    """Diagnose, run what is proposed, diagnose again."""
    hidden = EffectSetting(name, "turn", CASES[name])
    recordings = {f"first{seed}": record(machine, hidden, seed, folder / f"first{seed}.mf4", jog(TRAIN_deg)) for seed in FIRST_SEEDS}
    held_out = {"other": record(machine, hidden, HELD_OUT_SEED, folder / "other.mf4", jog(HELD_OUT_deg))}
    outcome = diagnose(machine, recordings, held_out)
    table: dict[str, Any] = {"first": said(outcome), "rounds": []}
    for number in range(1, ROUNDS + 1):
        proposal = outcome.proposal
        if proposal is None:
            break
        answer = folder / f"answer{number}"
        write_diagnosis(outcome, machine, answer)
        experiment = read_experiment(answer / NEXT_EXPERIMENT, machine)
        further = {
            f"next{number}_{seed}": record(machine, hidden, seed, folder / f"next{number}_{seed}.mf4", experiment) for seed in NEXT_SEEDS
        }
        shown = shown_by(outcome, machine, further)
        recordings |= further
        outcome = diagnose(machine, recordings, held_out)
        rivals = [
            {"from": model.name, "predicted_if_first": ahead, "predicted_if_rival": behind, "shown": d}
            for model, (ahead, behind), d in zip(proposal.models[1:], proposal.separations, shown, strict=True)
        ]
        kind = type(proposal.experiment).__name__
        table["rounds"].append({"first": proposal.models[0].name, "experiment": kind, "rivals": rivals, "then": said(outcome)})
    return table


def cpu_s() -> float:
    """Of this process and those it waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def rounded(value: Any) -> Any:
    """Numbers to four digits."""
    if isinstance(value, Mapping):
        return {key: rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [rounded(entry) for entry in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main() -> int:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], help="which effects to hide; all by default")
    arguments = parser.parse_args()
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"circle": {}}
    results.pop("search_on_the_carm", None)
    machine = load_machine(TABLE)
    for name in arguments.cases or CASES:
        used = cpu_s()
        with tempfile.TemporaryDirectory() as folder:
            results["circle"][name] = circle(machine, name, Path(folder)) | {"cpu_s": cpu_s() - used}
        print(name, json.dumps(rounded(results["circle"][name])), flush=True)
        RESULTS.write_text(json.dumps(rounded(results), indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
