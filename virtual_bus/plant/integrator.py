"""One plant step: slow equations at the midpoint, stiff linear part by a Taylor flow, friction implicitly.

The method is explained in docs/explanation/plant.md. The functions are compiled for one plant: `model` and `work` are its records
(records.py), and its own equations are handed in as compiled functions. Positions q and speeds v obey

    M(q) v' = effort - bias(q, v) - K (q - rest) - D v + friction,

with the effects' inertia in M, their efforts in the bias, and the efforts of effects with a memory beside the friction.
"""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled, compiled_in_place
from virtual_bus.effects.motion import FrictionOf, LimitedBy, ReactionOf, RippleOf
from virtual_bus.effects.table import MAX_REACTIONS
from virtual_bus.plant.drives import DRIVE_STATES, drive_joints, load_joints, remember_targets
from virtual_bus.plant.friction import rub, rubs
from virtual_bus.plant.linear import invert, multiply
from virtual_bus.plant.reactions import begin_reactions, end_reactions
from virtual_bus.plant.records import Equations

TAYLOR_ORDER = 8  # stable up to 3.4 times the step at the highest natural frequency, its error (wh)^9/9! per step


@compiled
def flow(h: float, model: np.record, work: np.record) -> None:
    """Move on by h [s] at frozen inertia and bias: Taylor series of the linear equations, in place."""
    n = len(work.position)
    for i in range(n):
        spring = model.stiffness[i] * (work.position[i] - model.rest_position[i])
        work.lower_derivative[i] = work.speed[i]
        work.force[i] = work.load[i] + work.friction[i] - spring - model.damping[i] * work.speed[i]
        work.position[i] += h * work.speed[i]
        work.acceleration[i] = 0.0
    weight = 1.0  # h^(k-1) / (k-1)! of derivative k
    for k in range(1, TAYLOR_ORDER + 1):
        multiply(work.inverse, work.force, work.derivative)
        speed_weight = weight * h / k
        position_weight = speed_weight * h / (k + 1)
        for i in range(n):
            work.acceleration[i] += weight * work.derivative[i]
            work.speed[i] += speed_weight * work.derivative[i]
            work.position[i] += position_weight * work.derivative[i]
            work.force[i] = -model.stiffness[i] * work.lower_derivative[i] - model.damping[i] * work.derivative[i]
            work.lower_derivative[i] = work.derivative[i]
        if k == 1:
            for i in range(n):
                work.start_acceleration[i] = work.derivative[i]
        weight = speed_weight


@compiled
def respond(j: int, h: float, model: np.record, work: np.record) -> None:
    """Find the change of all positions and speeds within h [s] per unit of constant effort on joint j, to third order in h."""
    n = len(work.position)
    for i in range(n):
        first = work.inverse[i, j]
        work.speed_response[j, i] = h * first
        work.position_response[j, i] = h * h / 2.0 * first
        work.force[i] = -model.damping[i] * first
    multiply(work.inverse, work.force, work.derivative)
    for i in range(n):
        work.speed_response[j, i] += h * h / 2.0 * work.derivative[i]
        work.position_response[j, i] += h * h * h / 6.0 * work.derivative[i]
        work.force[i] = -model.stiffness[i] * work.inverse[i, j] - model.damping[i] * work.derivative[i]
    multiply(work.inverse, work.force, work.derivative)
    for i in range(n):
        work.speed_response[j, i] += h * h * h / 6.0 * work.derivative[i]


@compiled
def advance_one(equations: Equations, friction_of: FrictionOf, reaction_of: ReactionOf, model: np.record, work: np.record) -> None:
    """Take one plant step of `model.step_s`.

    It goes from and to work.position, speed, acceleration (at the step's end) and friction.
    """
    n = len(work.position)
    h = model.step_s
    for i in range(n):
        work.query_position[i] = work.position[i] + 0.5 * h * (work.speed[i] + 0.25 * h * work.acceleration[i])
        work.query_speed[i] = work.speed[i] + 0.5 * h * work.acceleration[i]
    work.query_time_s = work.time_s + 0.5 * h
    equations(model, work)
    invert(work.mass, work.pivots, work.inverse)
    any_friction = False
    inner = h / model.inner_steps
    for j in range(n):
        work.load[j] = work.effort[j] - work.bias[j]
        if rubs(j, model, work):
            any_friction = True
            respond(j, inner, model, work)
        else:
            work.friction[j] = 0.0
            if model.reacts[j]:  # or shares a friction
                any_friction = True
                respond(j, inner, model, work)
    for part in range(model.inner_steps):
        for j in range(n):
            work.start_speed[j] = work.speed[j]
        if model.reaction_count > 0:
            for j in range(n):
                work.start_position[j] = work.position[j]
            begin_reactions(model, work)
        flow(inner, model, work)
        if any_friction:
            rub(friction_of, reaction_of, inner, model, work)
            if model.reaction_count > 0:
                end_reactions(reaction_of, inner, model, work)
        if part == 0:
            for i in range(n):
                work.first_acceleration[i] = work.start_acceleration[i]
    work.time_s += h


@compiled
def read_state(imus: int, axes: int, state: np.ndarray, model: np.record, work: np.record) -> None:
    """Copy the state vector into the work record; the drives' part stays where it is."""
    n = len(work.position)
    for i in range(n):
        work.position[i] = state[i]
        work.speed[i] = state[n + i]
        work.acceleration[i] = state[2 * n + i]
        work.friction[i] = state[3 * n + i]
    for k in range(6 * imus):
        work.filtered[k] = state[4 * n + k]
    work.time_s = state[4 * n + 6 * imus]
    slot = 4 * n + 6 * imus + 1 + axes * DRIVE_STATES
    for row in range(model.reaction_count):
        work.memory[row, 0] = state[slot + 3 * row]
        work.memory[row, 1] = state[slot + 3 * row + 1]
        work.reaction[row] = state[slot + 3 * row + 2]
    slot += 3 * MAX_REACTIONS
    for k in range(6 * imus):
        work.filtered_slope[k] = state[slot + k]


@compiled
def write_state(imus: int, axes: int, state: np.ndarray, model: np.record, work: np.record) -> None:
    """Copy the work record into the state vector."""
    n = len(work.position)
    for i in range(n):
        state[i] = work.position[i]
        state[n + i] = work.speed[i]
        state[2 * n + i] = work.acceleration[i]
        state[3 * n + i] = work.friction[i]
    for k in range(6 * imus):
        state[4 * n + k] = work.filtered[k]
    state[4 * n + 6 * imus] = work.time_s
    slot = 4 * n + 6 * imus + 1 + axes * DRIVE_STATES
    for row in range(model.reaction_count):
        state[slot + 3 * row] = work.memory[row, 0]
        state[slot + 3 * row + 1] = work.memory[row, 1]
        state[slot + 3 * row + 2] = work.reaction[row]
    slot += 3 * MAX_REACTIONS
    for k in range(6 * imus):
        state[slot + k] = work.filtered_slope[k]


@compiled
def read_imus(imu: Equations, position: np.ndarray, speed: np.ndarray, acceleration: np.ndarray, model: np.record, work: np.record) -> None:
    """Evaluate the unfiltered IMU channels of this motion, into work.reading."""
    for i in range(len(position)):
        work.query_position[i] = position[i]
        work.query_speed[i] = speed[i]
        work.query_acceleration[i] = acceleration[i]
    imu(model, work)


@compiled
def second_order(k: int, model: np.record, work: np.record) -> None:
    """Take one plant step of a channel's second-order low pass."""
    y, slope, start, end = work.filtered[k], work.filtered_slope[k], work.start_reading[k], work.reading[k]
    by = model.second_weights
    work.filtered[k] = by[k, 0, 0] * y + by[k, 0, 1] * slope + by[k, 0, 2] * start + by[k, 0, 3] * end
    work.filtered_slope[k] = by[k, 1, 0] * y + by[k, 1, 1] * slope + by[k, 1, 2] * start + by[k, 1, 3] * end


@compiled_in_place
def advance(
    axis_joints: tuple[int, ...], imus: int, equations: Equations, friction_of: FrictionOf, reaction_of: ReactionOf, limited_by: LimitedBy,
    ripple_of: RippleOf, imu: Equations, state: np.ndarray, effort: np.ndarray, brakes: np.ndarray, model: np.record, work: np.record,
) -> None:  # fmt: skip
    """Take one sample: `model.steps` plant steps at constant targets of the drives.

    The IMUs' low passes run along with them.
    """
    n = len(work.position)
    first_drive = 4 * n + 6 * imus + 1
    read_state(imus, len(axis_joints), state, model, work)
    load_joints(axis_joints, effort, brakes, model, work)
    for step in range(model.steps):
        if imus > 0:
            for i in range(n):
                work.first_position[i] = work.position[i]
                work.first_speed[i] = work.speed[i]
        if model.has_drive_effects:
            drive_joints(axis_joints, first_drive, step, limited_by, ripple_of, state, effort, model, work)
        advance_one(equations, friction_of, reaction_of, model, work)
        if imus > 0:
            # The bias is that of the step's middle: half a step ahead at the start, half a step behind at the end, so the error over the
            # step is of second order. The end of the last step in place of this one's start would make it of first order; besides, its
            # effort may have been another.
            read_imus(imu, work.first_position, work.first_speed, work.first_acceleration, model, work)
            for k in range(6 * imus):
                work.start_reading[k] = work.reading[k]
            read_imus(imu, work.position, work.speed, work.acceleration, model, work)
            for k in range(6 * imus):
                if model.is_filtered[k] == 2:
                    second_order(k, model, work)
                    continue
                old, start, end = model.filter_weights[k, 0], model.filter_weights[k, 1], model.filter_weights[k, 2]
                work.filtered[k] = old * work.filtered[k] + start * work.start_reading[k] + end * work.reading[k]
    if model.has_drive_effects:
        remember_targets(len(axis_joints), first_drive, state, effort, model)
    write_state(imus, len(axis_joints), state, model, work)
