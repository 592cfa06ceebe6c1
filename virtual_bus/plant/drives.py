"""Drives from their targets to efforts on the joints: delay, low pass, limit, constant, ripple, and the brakes.

A drive's part of the state vector is [current i, its rate i', the last targets, newest first].
"""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.motion import DriveState, LimitedBy, RippleOf
from virtual_bus.effects.table import HELD_SAMPLES, LIMITS

DRIVE_STATES = 2 + HELD_SAMPLES


@compiled
def load_joints(axis_joints: tuple[int, ...], effort: np.ndarray, brakes: np.ndarray, model: np.record, work: np.record) -> None:
    """Spread the drives' efforts and the brakes over the joints."""
    for i in range(len(work.effort)):
        work.effort[i] = 0.0
        work.brake[i] = 0.0
    for axis in range(len(axis_joints)):
        j = axis_joints[axis]
        work.effort[j] += model.effort_gain[axis] * effort[axis]
        work.brake[j] += model.brake_effort[j] * brakes[axis]


@compiled
def held_target(axis: int, first: int, begin: float, end: float, state: np.ndarray, effort: np.ndarray, model: np.record) -> float:
    """Return the mean target of a delayed drive between two shares of the sample period.

    Where both shares are equal it is the target of that instant.
    """
    samples = model.delay_samples[axis]
    whole = int(samples)
    switch: float = samples - whole  # share of the period at which the newer target takes over
    held = first + axis * DRIVE_STATES + 2
    newer: float = effort[axis] if whole == 0 else state[held + whole - 1]
    if switch <= begin:
        return newer
    older: float = state[held + whole]
    if switch >= end:
        return older
    return older + (newer - older) * (end - switch) / (end - begin)


@compiled
def target_at_sync(axis: int, first: int, state: np.ndarray, effort: np.ndarray, model: np.record) -> float:
    """Return the target on which a drive acts at a SYNC: where its delay ends within the period that begins, still the older one."""
    samples = model.delay_samples[axis]
    whole = int(samples)
    held = first + axis * DRIVE_STATES + 2
    if samples > whole:
        older: float = state[held + whole]
        return older
    newer: float = effort[axis] if whole == 0 else state[held + whole - 1]
    return newer


@compiled
def flowing(axis: int, current: float, speed: float, position: float, limited_by: LimitedBy, model: np.record) -> float:
    """Return the part of a current that passes the drive's supply and limit."""
    for row in range(LIMITS):
        if model.limit_rows[axis, row, 0] >= 0.0:
            drive = DriveState(current, speed, position, model.drive_ratio[axis])
            current = limited_by(int(model.limit_rows[axis, row, 0]), drive, model.limit_rows[axis, row])
    return current


@compiled
def gain_at(axis: int, position: float, ripple_of: RippleOf, model: np.record) -> float:
    """Return the effort on the joint per unit of the drive at this position."""
    if model.ripple_rows[axis, 0] < 0.0:
        gain: float = model.effort_gain[axis]
        return gain
    drive = DriveState(0.0, 0.0, position, model.drive_ratio[axis])
    gain = model.effort_gain[axis] * ripple_of(int(model.ripple_rows[axis, 0]), drive, model.ripple_rows[axis])
    return gain


@compiled
def drive_joints(
    axis_joints: tuple[int, ...], first: int, step: int, limited_by: LimitedBy, ripple_of: RippleOf, state: np.ndarray, effort: np.ndarray,
    model: np.record, work: np.record,
) -> None:  # fmt: skip
    """Find the drives' efforts on the joints, mean over a plant step, and the drives' states at its end."""
    for i in range(len(work.effort)):
        work.effort[i] = 0.0
    for axis in range(len(axis_joints)):
        j = axis_joints[axis]
        target = held_target(axis, first, step / model.steps, (step + 1) / model.steps, state, effort, model)
        current = target
        if model.is_lagging[axis]:
            slot = first + axis * DRIVE_STATES
            error, rate = state[slot] - target, state[slot + 1]
            current = target + model.lag_mean[axis, 0] * error + model.lag_mean[axis, 1] * rate
            state[slot] = target + model.lag_transition[axis, 0, 0] * error + model.lag_transition[axis, 0, 1] * rate
            state[slot + 1] = model.lag_transition[axis, 1, 0] * error + model.lag_transition[axis, 1, 1] * rate
        speed = work.speed[j] + 0.5 * model.step_s * work.acceleration[j]
        position = work.position[j] + 0.5 * model.step_s * (work.speed[j] + 0.25 * model.step_s * work.acceleration[j])
        work.effort[j] += gain_at(axis, position, ripple_of, model) * flowing(axis, current, speed, position, limited_by, model)


@compiled
def remember_targets(axes: int, first: int, state: np.ndarray, effort: np.ndarray, model: np.record) -> None:
    """Shift the targets that delayed drives hold by one sample."""
    for axis in range(axes):
        if model.delay_samples[axis] > 0.0:
            held = first + axis * DRIVE_STATES + 2
            for k in range(HELD_SAMPLES - 1, 0, -1):
                state[held + k] = state[held + k - 1]
            state[held] = effort[axis]


@compiled
def drive_currents(
    axis_joints: tuple[int, ...], first: int, limited_by: LimitedBy, state: np.ndarray, effort: np.ndarray, model: np.record,
    currents: np.ndarray,
) -> None:  # fmt: skip
    """Find the currents (axes,) that flow at the start of a sample under these targets."""
    n = len(model.stiffness)
    for axis in range(len(axis_joints)):
        current = effort[axis]
        if model.has_drive_effects:
            j = axis_joints[axis]
            current = target_at_sync(axis, first, state, effort, model)
            if model.is_lagging[axis]:
                current = state[first + axis * DRIVE_STATES]
            current = flowing(axis, current, state[n + j], state[j], limited_by, model)
        currents[axis] = current


@compiled
def load_instant(
    axis_joints: tuple[int, ...], first: int, limited_by: LimitedBy, ripple_of: RippleOf, state: np.ndarray, effort: np.ndarray,
    brakes: np.ndarray, model: np.record, work: np.record,
) -> None:  # fmt: skip
    """Find the efforts and brakes on the joints at the start of a sample under these targets."""
    load_joints(axis_joints, effort, brakes, model, work)
    if model.has_drive_effects:
        for i in range(len(work.effort)):
            work.effort[i] = 0.0
        drive_currents(axis_joints, first, limited_by, state, effort, model, work.currents)
        for axis in range(len(axis_joints)):
            j = axis_joints[axis]
            work.effort[j] += gain_at(axis, state[j], ripple_of, model) * work.currents[axis]


@compiled
def drive_gains(axis_joints: tuple[int, ...], ripple_of: RippleOf, model: np.record, work: np.record) -> None:
    """Find the effort on the joints per unit of every drive at work.query_position, into work.gains."""
    for axis in range(len(axis_joints)):
        work.gains[axis] = gain_at(axis, work.query_position[axis_joints[axis]], ripple_of, model)
