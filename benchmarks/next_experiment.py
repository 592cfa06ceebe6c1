"""What the search for a separating experiment costs on the C-arm: `python benchmarks/next_experiment.py [--jobs N]` prints JSON.

Two hypotheses of the roll axis's friction, the noise of its sensors assumed white. Free runs that every draw and every step of the search
would take, if none were skipped, stand beside those that were made.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time

import numpy as np

from hil.diagnosis.experiment_families import requests
from hil.diagnosis.next_experiment import DRAWS, REFINEMENTS, propose
from hil.diagnosis.noise import assumed_noise
from hil.diagnosis.retune import tunable
from hil.diagnosis.separation import Model
from hil.machine import load_machine
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting

MACHINE = load_machine("carm")
NOISE = {
    "current_propeller": 0.01, "current_roll": 0.01, "position_propeller": 1e-5, "position_roll": 1e-5, "imu_x": 0.02, "imu_y": 0.02,
    "imu_z": 0.02, "gyro_x": 1e-3, "gyro_y": 1e-3, "gyro_z": 1e-3,
}  # fmt: skip
"""Rms in each channel's unit."""

RIVALS = (("quadratic_friction", "Fv2", 60.0), ("viscous_friction", "Fv", 8.0))


def model(name: str, parameter: str, value: float) -> Model:
    """An effect at the roll axis, every number of the machine that re-tuning may change free beside it."""
    plant = compile_plant(MACHINE.plant)
    indices = tunable(plant.parameters)
    effect = EffectSetting(name, "roll", {parameter: value})
    return Model(plant.nominal, (effect,), indices, 0.1 * np.abs(plant.nominal[indices]), ((0, parameter),))


def cpu_s() -> float:
    """Of this process and those it waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2)
    jobs = parser.parse_args().jobs
    rows = np.random.default_rng(0).standard_normal((4000, len(NOISE))) * list(NOISE.values())
    noise = assumed_noise([rows], tuple(NOISE), MACHINE)
    models = [model(*rival) for rival in RIVALS]
    began, used = time.monotonic(), cpu_s()
    found = propose(MACHINE, models, noise, tuple(NOISE), jobs=jobs)
    assert found is not None, "nothing within the limits separates the rivals"
    in_full = (len(requests(MACHINE)) * DRAWS + REFINEMENTS) * (2 + len(models[1].indices) + 1)
    table = {"jobs": jobs, "tuned_numbers": len(models[1].indices), "free_runs": found.runs, "free_runs_if_none_were_skipped": in_full}
    table |= {"cpu_s": cpu_s() - used, "wall_s": time.monotonic() - began, "separation": found.separation}
    print(json.dumps(table, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
