"""A Stäubli TX40, six joints at once: the set `tx40` of the baselines, in joint positions and joint torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from real.common import DATA, RealSet, friction_along, machine_of, nrmse, recording_of
from scipy.signal import butter, sosfiltfilt

from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.inverse_dynamics import along_module
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting

JOINTS = 6
TORQUE_GEAR = np.diag([32.0, 32.0, 45.0, -48.0, 45.0, 32.0])
"""Joint torques from motor torques. Motor 6 turns with joints 5 and 6, so its torque acts on both."""
TORQUE_GEAR[4, 5] = 32.0
POSITION_GEAR = TORQUE_GEAR.T
"""Motor positions from joint positions, less those at which the source has zero."""
ZERO_rad = np.array([0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0])
MOTION_END_s = 7.8
"""The robot stands from here on."""
SPLITS_s = {"readme": ((0.0, 4.6), (4.6, MOTION_END_s)), "reversed": ((3.2, MOTION_END_s), (0.0, 3.2))}
"""Training and held-out part."""

RECORDED_Hz = 5000.0
KEPT = 5
"""Every fifth row is judged: 1 kHz."""
LOW_PASS_Hz = 20.0
FILTER_ORDER = 4
SLIP_SPEED_rad_s = 0.04
"""Dry friction has its mean over speeds of this deviation: as near as it comes to the baselines' hyperbolic tangent of speed / 0.05."""


def splits() -> dict[str, RealSet]:
    """Return the baselines' splits: "readme" and "reversed"."""
    machine = machine_of("tx40")
    seconds, position, torque = recorded()

    def part(begin_s: float, end_s: float) -> dict[str, Recording]:
        rows = (seconds >= begin_s) & (seconds < end_s)
        columns = {}
        for j, axis in enumerate(machine.axes):
            columns[f"position_{axis}"] = "rad", position[rows, j]
            columns[f"effort_{axis}"] = "Nm", torque[rows, j]
        begins = motion()[1][np.argmax(rows) // KEPT].tolist()
        return {f"{begin_s} to {end_s} s": recording_of(machine, seconds[rows], columns, {"speeds": begins})}

    return {name: RealSet(machine, part(*train), part(*held_out)) for name, (train, held_out) in SPLITS_s.items()}


@cache
def recorded() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time [s] (rows,), positions of the joints [rad] and torques on them [Nm] (rows, joints), at 5 kHz."""
    table = np.genfromtxt(DATA / "tx40" / "tx40.csv.gz", delimiter=",", skip_header=1)
    return table[:, 0], table[:, 1:7] @ np.linalg.inv(POSITION_GEAR).T + ZERO_rad, table[:, 7:] @ TORQUE_GEAR.T


def errors(split: str, machine: Machine, values: np.ndarray | None, effects: Sequence[EffectSetting]) -> dict[str, dict[str, float]]:
    """Return the baselines' error of an answer: NRMSE of each joint's torque by inverse dynamics.

    Motion, model torque and measured torque pass a zero-phase low-pass of 20 Hz. Torques were measured, so effects between a drive's
    command and its torque do not count.

    Parameters
    ----------
    split : str
        One of `splits`.
    machine : Machine
    values : (parameters,) array or None
        Plant parameters; None: the machine's own.
    effects : sequence of EffectSetting
        Besides the machine's own.
    """
    seconds, _, torque = recorded()
    seconds = seconds[::KEPT]
    measured = low_pass(torque, RECORDED_Hz)[::KEPT]
    model = low_pass(inverse_dynamics(machine, values, effects), RECORDED_Hz / KEPT)
    found: dict[str, dict[str, float]] = {f"torque_{j + 1}": {} for j in range(JOINTS)}
    for part, (begin_s, end_s) in zip(("train", "held_out"), SPLITS_s[split], strict=True):
        rows = (seconds >= begin_s) & (seconds < end_s)
        for j in range(JOINTS):
            found[f"torque_{j + 1}"][part] = nrmse(model[rows, j], measured[rows, j])
    return found


def inverse_dynamics(machine: Machine, values: np.ndarray | None, effects: Sequence[EffectSetting]) -> np.ndarray:
    """Return the torques (rows, joints), in the drives' units, that the whole recorded motion takes at 1 kHz."""
    plant = compile_plant(replace(machine.plant, sample_period_s=KEPT / RECORDED_Hz, substeps=1))
    module, work = along_module(plant), plant.new_work()
    model = plant.model(values, (*machine.plant.effects, *effects))
    position, speed, acceleration = motion()
    needed = np.zeros_like(position)
    module.efforts(model, work, position, speed, acceleration, needed)
    friction = friction_along(plant, model, position, speed, SLIP_SPEED_rad_s, needed)
    total: np.ndarray = (needed + friction)[:, plant.driven_joints] / model["effort_gain"][0]
    return total


@cache
def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions, speeds and accelerations (rows, joints) of the whole recording at 1 kHz, smoothed."""
    position = low_pass(recorded()[1], RECORDED_Hz)
    speed = np.gradient(position, 1.0 / RECORDED_Hz, axis=0)
    acceleration = np.gradient(speed, 1.0 / RECORDED_Hz, axis=0)
    return tuple(np.ascontiguousarray(each[::KEPT]) for each in (position, speed, acceleration))  # type: ignore[return-value]


def low_pass(signal: np.ndarray, rate_Hz: float) -> np.ndarray:
    """Return the signal (rows, ...) through the metric's Butterworth filter, forwards and backwards."""
    return np.asarray(sosfiltfilt(butter(FILTER_ORDER, LOW_PASS_Hz, fs=rate_Hz, output="sos"), signal, axis=0))
