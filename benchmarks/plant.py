"""How fast the plant is: alone against mujoco.rollout, and in closed loop at 1 kHz with friction.

    python benchmarks/plant.py [--json FILE]        # - for standard output

Alone: `carm` without friction and sensors under one torque input at its sample rate. Each simulator runs at the largest step (a whole
fraction of a sample) at which every joint stays within 1e-4 of its own travel from the converged answer; MuJoCo with whichever of its
integrators is then the fastest. One thread each, turns taken, best time of several.
Closed loop: 60 s at 1 kHz with Coulomb and Stribeck friction on both axes, all sensors read at every sample, warm.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from hil.machine import Machine, load_machine
from hil.machine.mjcf import to_mjcf
from hil.simulation import Inputs, Simulator
from hil.terminal.output import Answer
from virtual_bus.plant.compiled import CompiledPlant, compile_plant
from virtual_bus.plant.statics import holding_effort, resting_state
from virtual_bus.settings import EffectSetting, PlantSettings

SECONDS = 10.0
TOLERANCE = 1e-4
STEPS = (1, 2, 3, 4, 5, 6, 8, 12, 16, 24, 32, 64, 128)
CONVERGED_STEPS = 256
HALVINGS = (1, 2, 4, 8, 16, 32)
POSE = np.array([0.5, 0.4])
INTEGRATORS = ("Euler", "implicitfast", "implicit", "RK4")
TURNS = 15
CLOSED_LOOP_RATE_Hz = 1000.0
CLOSED_LOOP_SECONDS = 60.0
FRICTION = tuple(
    effect
    for axis in ("propeller", "roll")
    for effect in (
        EffectSetting("coulomb_friction", axis, {"Fc": 12.0}),
        EffectSetting("stribeck_friction", axis, {"Fs_minus_Fc": 5.0, "vs": 0.02, "delta": 2.0}),
    )
)

ROLLOUT = '''"""Generated: a plant under given efforts; do not edit."""

from PLANT import advance

from virtual_bus.compilation.jit import compiled_and_cached


@compiled_and_cached
def run(state, efforts, brakes, model, work, positions):
    for k in range(efforts.shape[0]):
        advance(state, efforts[k], brakes, model, work)
        for j in range(positions.shape[1]):
            positions[k, j] = state[j]
'''


class OurPlant:
    """Our plant at a number of steps per sample."""

    def __init__(
        self, plant: CompiledPlant, start: np.ndarray, efforts: np.ndarray, steps: int, effects: tuple[EffectSetting, ...] = ()
    ) -> None:
        self._kernel = plant.fuse("rollout", ROLLOUT)
        self._model = compile_plant(replace(plant.settings, substeps=steps)).model(effects=effects)
        self._work, self._start, self._efforts = plant.new_work(), plant.new_state(start), efforts
        self.positions = np.zeros((len(efforts), plant.joints))

    def run(self) -> None:
        brakes = np.zeros(self._efforts.shape[1])
        self._kernel.run(self._start.copy(), self._efforts, brakes, self._model, self._work, self.positions)


class Mujoco:
    """The exported model under mujoco.rollout with one integrator, at a number of steps per sample."""

    def __init__(self, settings: PlantSettings, start: np.ndarray, efforts: np.ndarray, integrator: str, steps: int) -> None:
        self._model = mujoco.MjModel.from_xml_string(to_mjcf(settings, "carm"))
        self._model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
        self._model.opt.timestep = settings.sample_period_s / steps
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = start
        full = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._initial = np.zeros(mujoco.mj_stateSize(self._model, full))
        mujoco.mj_getState(self._model, self._data, self._initial, full)
        self._control = np.repeat(efforts, steps, axis=0)[None]
        self._states = np.zeros((1, self._control.shape[1], len(self._initial)))
        self._steps = steps

    def run(self) -> None:
        rollout.rollout(self._model, self._data, self._initial, self._control, state=self._states)

    @property
    def positions(self) -> np.ndarray:
        return self._states[0, self._steps - 1 :: self._steps, 1 : 1 + self._model.nq]


def error(positions: np.ndarray, converged: np.ndarray) -> float:
    """Largest difference of any joint, in terms of that joint's own travel; infinite where it diverged."""
    if not np.isfinite(positions).all():
        return float("inf")
    return float((np.abs(positions - converged).max(axis=0) / np.ptp(converged, axis=0)).max())


def largest_step(make: Callable[[int], Any], converged: np.ndarray) -> tuple[Any, int, float] | None:
    """The simulator at the fewest steps per sample that keep the tolerance, that number, and its error."""
    for steps in STEPS:
        simulator = make(steps)
        simulator.run()
        found = error(simulator.positions, converged)
        if found <= TOLERANCE:
            return simulator, steps, found
    return None


def errors_by_steps(plant: CompiledPlant, start: np.ndarray, efforts: np.ndarray, effects: tuple[EffectSetting, ...]) -> dict[int, float]:
    """Our plant's error at halving steps."""
    converged = OurPlant(plant, start, efforts, CONVERGED_STEPS, effects)
    converged.run()
    errors = {}
    for steps in HALVINGS:
        coarse = OurPlant(plant, start, efforts, steps, effects)
        coarse.run()
        errors[steps] = error(coarse.positions, converged.positions)
    return errors


def best_times_s(simulators: dict[str, Any], turns: int) -> dict[str, float]:
    """Best time of each, in turns, so that whatever else the computer does meets all alike."""
    best = dict.fromkeys(simulators, float("inf"))
    for _ in range(turns):
        for name, simulator in simulators.items():
            begin = time.perf_counter()
            simulator.run()
            best[name] = min(best[name], time.perf_counter() - begin)
    return best


def plant_alone(machine: Machine) -> dict[str, Any]:
    settings = replace(machine.plant, imus=(), effects=())
    plant = compile_plant(settings)
    start = resting_state(plant, plant.model(), POSE, held_by_brakes=False)[: plant.joints]
    time_s = np.arange(round(SECONDS / settings.sample_period_s))[:, None] * settings.sample_period_s
    input_A = 2.0 * np.sin(2.0 * np.pi * time_s * [0.7, 0.5]) + np.sin(2.0 * np.pi * time_s * [8.0, 14.0])
    efforts = holding_effort(plant, plant.model(), POSE) + input_A

    reference = OurPlant(plant, start, efforts, CONVERGED_STEPS)
    reference.run()
    check = Mujoco(settings, start, efforts, "RK4", 16)
    check.run()
    found = {"ours": largest_step(lambda steps: OurPlant(plant, start, efforts, steps), reference.positions)}
    for integrator in INTEGRATORS:
        found[f"mujoco {integrator}"] = largest_step(
            lambda steps, integrator=integrator: Mujoco(settings, start, efforts, integrator, steps), reference.positions
        )
    usable = {name: entry for name, entry in found.items() if entry is not None}
    times_s = best_times_s({name: entry[0] for name, entry in usable.items()}, TURNS)
    simulators = {
        name: {
            "steps_per_sample": steps,
            "step_s": settings.sample_period_s / steps,
            "error": deviation,
            "seconds": times_s[name],
            "us_per_step": 1e6 * times_s[name] / (steps * len(efforts)),
            "times_real_time": SECONDS / times_s[name],
        }
        for name, (_, steps, deviation) in usable.items()
    }
    fastest = min((name for name in simulators if name != "ours"), key=lambda name: times_s[name])
    return {
        "degrees_of_freedom": plant.joints,
        "simulated_s": SECONDS,
        "tolerance": TOLERANCE,
        "converged_answers_differ_by": error(check.positions, reference.positions),
        "error_by_steps_per_sample": errors_by_steps(plant, start, efforts, ()),
        "error_by_steps_per_sample_with_friction": errors_by_steps(plant, start, efforts, FRICTION),
        "simulators": simulators,
        "mujoco_fastest": fastest,
        "times_faster_than_mujoco": times_s[fastest] / times_s["ours"],
    }


def resampled(sections: np.ndarray, from_Hz: float, to_Hz: float) -> np.ndarray:
    """Second-order sections at another sample rate: poles and zeros through the bilinear map, each section's gain kept at 0.5 Hz."""
    ratio = from_Hz / to_Hz

    def moved(roots: np.ndarray) -> np.ndarray:
        y = ratio * (roots - 1.0) / (roots + 1.0)
        return (1.0 + y) / (1.0 - y)

    def gain(numerator: np.ndarray, denominator: np.ndarray, rate_Hz: float) -> complex:
        z = np.exp(2j * np.pi * 0.5 / rate_Hz)
        return np.polyval(numerator, z) / np.polyval(denominator, z)

    rows = []
    for row in sections:
        before = [np.trim_zeros(polynomial, "b") for polynomial in (row[:3], row[3:])]
        after = [np.real(np.poly(moved(np.roots(polynomial)))) for polynomial in before]
        after[0] = after[0] * abs(gain(*before, from_Hz)) / abs(gain(*after, to_Hz))
        rows.append(np.concatenate([np.pad(polynomial, (0, 3 - len(polynomial))) for polynomial in after]))
    return np.array(rows)


def closed_loop(machine: Machine) -> dict[str, Any]:
    controllers = tuple(
        replace(axis, position_sections=resampled(axis.position_sections, machine.sample_rate_Hz, CLOSED_LOOP_RATE_Hz))
        for axis in machine.controllers
    )
    plant = replace(machine.plant, sample_period_s=1.0 / CLOSED_LOOP_RATE_Hz, substeps=1)
    simulator = Simulator(replace(machine, plant=plant, controllers=controllers, sample_rate_Hz=CLOSED_LOOP_RATE_Hz))
    time_s = np.arange(round(CLOSED_LOOP_SECONDS * CLOSED_LOOP_RATE_Hz))[:, None] / CLOSED_LOOP_RATE_Hz
    reference = POSE + 0.035 * np.sin(2.0 * np.pi * time_s * [0.05, 0.05])
    excitation = 0.5 * np.sin(2.0 * np.pi * time_s * [8.0, 14.0])
    inputs = Inputs(reference, excitation, np.zeros_like(reference), None, POSE)
    best, outputs = float("inf"), None
    for _ in range(TURNS):
        begin = time.perf_counter()
        outputs = simulator.run(inputs, effects=FRICTION)
        best = min(best, time.perf_counter() - begin)
    assert outputs is not None
    return {
        "rate_Hz": CLOSED_LOOP_RATE_Hz,
        "plant_steps_per_sample": 1,
        "simulated_s": CLOSED_LOOP_SECONDS,
        "friction": sorted({effect.name for effect in FRICTION}),
        "largest_tracking_error_rad": float(np.abs(outputs.position - reference).max()),
        "seconds": best,
        "us_per_sample": 1e6 * best / len(reference),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="FILE", default="-", help="where the answer goes; - for standard output")
    arguments = parser.parse_args()
    to = Answer(arguments.json)
    mujoco.set_mju_user_warning(lambda _: None)  # a step too large diverges and is reported as such; no log file
    machine = load_machine("carm")
    answer = {
        "plant_alone": plant_alone(machine),
        "closed_loop": closed_loop(machine),
        "computer": {"processor": platform.machine(), "python": platform.python_version(), "mujoco": mujoco.__version__},
    }
    to.write(answer)


if __name__ == "__main__":
    main()
