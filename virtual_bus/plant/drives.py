"""From the drives' targets to efforts on the joints: delay, low pass, limit, constant, ripple, and the brakes.

A drive's part of the state vector is [current i, its rate i', the last targets, newest first].
"""

from __future__ import annotations

from virtual_bus.effects.motion import DriveState
from virtual_bus.effects.table import HELD_SAMPLES
from virtual_bus.plant.jit import compiled

DRIVE_STATES = 2 + HELD_SAMPLES


@compiled
def load_joints(axis_joints, effort, brakes, model, work):
    """Spread the drives' efforts and the brakes over the joints."""
    for i in range(len(work.effort)):
        work.effort[i] = 0.0
        work.brake[i] = 0.0
    for axis in range(len(axis_joints)):
        j = axis_joints[axis]
        work.effort[j] += model.effort_gain[axis] * effort[axis]
        work.brake[j] += model.brake_effort[j] * brakes[axis]


@compiled
def held_target(axis, first, begin, end, state, effort, model):
    """Mean target of a delayed drive between two shares of the sample period; an instant where they are equal."""
    samples = model.delay_samples[axis]
    whole = int(samples)
    switch = samples - whole  # share of the period at which the newer target takes over
    held = first + axis * DRIVE_STATES + 2
    newer = effort[axis] if whole == 0 else state[held + whole - 1]
    if switch <= begin:
        return newer
    older = state[held + whole]
    if switch >= end:
        return older
    return older + (newer - older) * (end - switch) / (end - begin)


@compiled
def target_at_sync(axis, first, state, effort, model):
    """Mean target of a delayed drive over the period that begins at a SYNC: a short delay reads little of the older target."""
    samples = model.delay_samples[axis]
    whole = int(samples)
    held = first + axis * DRIVE_STATES + 2
    newer = effort[axis] if whole == 0 else state[held + whole - 1]
    if samples == whole:
        return newer
    return newer + (samples - whole) * (state[held + whole] - newer)


@compiled
def flowing(axis, current, speed, position, limited_by, model):
    """What of a current passes the drive's limit."""
    if model.limit_rows[axis, 0] < 0.0:
        return current
    drive = DriveState(current, speed, position, model.drive_ratio[axis])
    return limited_by(int(model.limit_rows[axis, 0]), drive, model.limit_rows[axis])


@compiled
def gain_at(axis, position, ripple_of, model):
    """Effort on the joint per unit of the drive at this position."""
    if model.ripple_rows[axis, 0] < 0.0:
        return model.effort_gain[axis]
    drive = DriveState(0.0, 0.0, position, model.drive_ratio[axis])
    return model.effort_gain[axis] * ripple_of(int(model.ripple_rows[axis, 0]), drive, model.ripple_rows[axis])


@compiled
def drive_joints(axis_joints, first, step, limited_by, ripple_of, state, effort, model, work):
    """Efforts of the drives on the joints, mean over a plant step, and the drives' states at its end."""
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
def remember_targets(axes, first, state, effort, model):
    """One sample later: what was applied is what was held."""
    for axis in range(axes):
        if model.delay_samples[axis] > 0.0:
            held = first + axis * DRIVE_STATES + 2
            for k in range(HELD_SAMPLES - 1, 0, -1):
                state[held + k] = state[held + k - 1]
            state[held] = effort[axis]


@compiled
def drive_currents(axis_joints, first, limited_by, state, effort, model, currents):
    """Currents (axes,) that flow at the start of a sample under these targets."""
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
def load_instant(axis_joints, first, limited_by, ripple_of, state, effort, brakes, model, work):
    """Efforts and brakes on the joints at the start of a sample under these targets."""
    load_joints(axis_joints, effort, brakes, model, work)
    if model.has_drive_effects:
        for i in range(len(work.effort)):
            work.effort[i] = 0.0
        drive_currents(axis_joints, first, limited_by, state, effort, model, work.currents)
        for axis in range(len(axis_joints)):
            j = axis_joints[axis]
            work.effort[j] += gain_at(axis, state[j], ripple_of, model) * work.currents[axis]


@compiled
def drive_gains(axis_joints, ripple_of, model, work):
    """Effort on the joints per unit of every drive at work.query_position, into work.gains."""
    for axis in range(len(axis_joints)):
        work.gains[axis] = gain_at(axis, work.query_position[axis_joints[axis]], ripple_of, model)
