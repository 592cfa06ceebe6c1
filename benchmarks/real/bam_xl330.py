"""A Dynamixel XL330 servo that swings a weight in the loop of its firmware: the set `bam_xl330` of the baselines."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from real.common import AS_FILED, DATA, ControllerSide, RealSet, machine_of, nrmse, on_rows, recording_of

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Inputs, Simulator
from virtual_bus.settings import EffectSetting

AXIS = "servo"
MOTORS = {
    "m6": {},  # as in the machine file
    "m1": {"constant": "0.06785", "damping_Nm_s_rad": "0.0219", "rotor_inertia_kg_m2": "0.00164"},
}
SUPPLY_V = 7.4
FULL_LOAD = 885.0
SIGNED = 2**15
"""Of the 16 bits that load is recorded in."""
V_PER_RAD = SUPPLY_V * 4096.0 / (2.0 * np.pi) / (256.0 * FULL_LOAD)
"""For a gain of 1."""

README = ([("sin_time_square", 400), ("sin_sin", 200)], [("sin_sin", 400), ("up_and_down", 200)])
TRAJECTORIES = ("sin_sin", "lift_and_drop", "up_and_down", "sin_time_square")
BY_GAIN = tuple([(trajectory, kp) for kp in gains for trajectory in TRAJECTORIES] for gains in ((100, 200), (400, 800)))

JUDGED_Hz = 200.0
FIRST_ROWS = 3
"""Whose mean is the first position."""
LOOP_Hz = 2400.0
"""The loop of a free run: a command acts one of its periods late and is held for one, which is on average as late as the metric's law,
which acts at once and is held for 1.25 ms."""
GOAL_EARLY_s = 1.5 / LOOP_Hz
"""So that the goal, which in the metric is that of the middle of the held time, is not late."""


@dataclass(frozen=True)
class Run:
    """One recording: its rows as recorded."""

    kp: int
    time_s: np.ndarray
    goal: np.ndarray
    position: np.ndarray
    load: np.ndarray
    is_on: np.ndarray


def splits() -> dict[str, RealSet]:
    """Return the baselines' splits: "readme m6", "readme m1", "gains m6" and "gains m1"."""
    found = {}
    for split, parts in (("readme", README), ("gains", BY_GAIN)):
        for motor in MOTORS:
            train, held_out = ({f"{name} kp {kp}": recording(motor, name, kp) for name, kp in part} for part in parts)
            found[f"{split} {motor}"] = RealSet(machine_of("bam_xl330", **MOTORS[motor]), train, held_out)
    return found


@cache
def runs() -> dict[tuple[str, int], Run]:
    """Return all recordings by trajectory and gain."""
    found = {}
    for path in sorted((DATA / "bam_xl330").glob("*.json")):
        content = json.loads(path.read_text())
        names = ("timestamp", "goal_position", "position", "load", "torque_enable")
        time_s, goal, position, load, is_on = (np.array([entry[name] for entry in content["entries"]], dtype=float) for name in names)
        load = np.where(load >= SIGNED, load - 2 * SIGNED, load)
        found[content["trajectory"], content["kp"]] = Run(content["kp"], time_s, goal, position, load, is_on)
    return found


def recording(motor: str, trajectory: str, kp: int) -> Recording:
    """Return one recording while the motor is on, under a machine file with its own gain.

    Off, the motor has no back-EMF either, which is the joint's damping here: no recording of this machine.
    """
    run = runs()[trajectory, kp]
    machine = machine_of("bam_xl330", **MOTORS[motor], position_sections=str([[V_PER_RAD * kp, 0.0, 0.0, 1.0, 0.0, 0.0]]))
    rows = run.is_on > 0.5
    columns = {
        f"reference_{AXIS}": ("rad", run.goal[rows]),
        f"position_{AXIS}": ("rad", run.position[rows]),
        f"command_{AXIS}": ("V", SUPPLY_V / FULL_LOAD * run.load[rows]),  # 885 times the duty, which the law commands
    }
    initial = {"speeds": [0.0], "controller_states": {AXIS: {"position": [[0.0, 0.0]]}}}
    start = float(run.position[:FIRST_ROWS].mean())
    return recording_of(machine, run.time_s[rows], columns, initial, experiment={"start_pose": [start]})


def errors(
    split: str, machine: Machine, values: np.ndarray | None, effects: Sequence[EffectSetting], side: ControllerSide = AS_FILED
) -> dict[str, dict[str, float]]:
    """Return the baselines' error of an answer: NRMSE of position and command in free runs of the closed loop, at 200 Hz.

    Where recordings go on after the motor is switched off, the error of the position from there is the channel "position, motor off".

    Parameters
    ----------
    split : str
        One of `splits`.
    machine : Machine
        The gain of its controller counts for nothing: each recording has its own.
    values : (parameters,) array or None
        Plant parameters; None: the machine's own. The joint's damping is back-EMF, and ends with the motor's voltage.
    effects : sequence of EffectSetting
        Besides the machine's own.
    side : ControllerSide
    """
    found: dict[str, dict[str, float]] = {"position": {}, "command": {}, "position, motor off": {}}
    fast = on_rows(machine, LOOP_Hz, 1)
    simulators = Simulator(fast), Simulator(replace(fast, controllers=()))
    for part, names in zip(("train", "held_out"), README if split.startswith("readme") else BY_GAIN, strict=True):
        pairs: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {channel: [] for channel in found}
        for run in (runs()[name] for name in names):
            for channel, pair in _free_run(simulators, run, values, (*machine.plant.effects, *effects), side).items():
                pairs[channel].append(pair)
        for channel, both in pairs.items():
            if both:
                found[channel][part] = nrmse([model for model, _ in both], [measured for _, measured in both])
    return {channel: error for channel, error in found.items() if error}


def _free_run(
    simulators: Sequence[Simulator], run: Run, values: np.ndarray | None, effects: Sequence[EffectSetting], side: ControllerSide
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return what simulation and recording have in every channel, at 200 Hz; the simulators are those of the motor on and off."""
    judged_s = np.arange(run.time_s[0], run.time_s[-1], 1.0 / JUDGED_Hz)
    position, load, is_on = (np.interp(judged_s, run.time_s, column) for column in (run.position, run.load, run.is_on))
    on = int(np.sum(is_on > 0.5))  # the first rows: it is never switched on again
    stride = round(LOOP_Hz / JUDGED_Hz)
    fine_s = run.time_s[0] + np.arange(on * stride + 1) / LOOP_Hz
    goal = np.interp(fine_s + GOAL_EARLY_s - side.lateness_s, run.time_s, run.goal)[:, None]
    machine, law = simulators[0].machine, np.array([[side.gain * V_PER_RAD * run.kp, 0.0, 0.0, 1.0, 0.0, 0.0]])
    controlled = Simulator(replace(machine, controllers=(replace(machine.controllers[0], position_sections=law),)))
    start, nothing = np.array([run.position[:FIRST_ROWS].mean()]), np.zeros_like(goal)
    states = {AXIS: {"position": [[0.0, 0.0]]}}
    outputs = controlled.run(Inputs(goal, nothing, nothing, None, start, states, np.zeros(1)), values, effects)
    turned, volts = outputs.position[:, 0], outputs.command[:, 0]
    rows = np.arange(on) * stride
    found = {"position": (turned[rows], position[:on]), "command": (FULL_LOAD / SUPPLY_V * volts[rows], load[:on])}
    if on < len(judged_s):
        plant = simulators[1].plant
        free = plant.nominal if values is None else np.array(values, dtype=float)
        free[[parameter.name for parameter in plant.parameters].index(f"{AXIS}.damping_Nm_s_rad")] = 0.0
        speed = np.array([np.polyfit(np.arange(-stride, 1) / LOOP_Hz, turned[-stride - 1 :], 2)[1]])
        nothing = np.zeros(((len(judged_s) - on) * stride, 1))
        outputs = simulators[1].run(Inputs(None, nothing, nothing, nothing, turned[-1:], None, speed), free, effects)
        found["position, motor off"] = (outputs.position[::stride, 0], position[on:])
    return found
