"""Readings of a plant at an instant: joint accelerations under the effort that acts from then on, and the IMUs without noise."""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.motion import FrictionOf, LimitedBy, ReactionOf, RippleOf
from virtual_bus.plant.drives import load_instant
from virtual_bus.plant.friction import SHARED_SWEEPS, STUCK_SPEED, SWEEPS, friction_level, rubs, shared_level, shared_speed
from virtual_bus.plant.integrator import read_imus, read_state
from virtual_bus.plant.linear import invert, multiply
from virtual_bus.plant.reactions import instant_reactions
from virtual_bus.plant.records import Equations


@compiled
def joint_acceleration(
    axis_joints: tuple[int, ...], imus: int, equations: Equations, friction_of: FrictionOf, reaction_of: ReactionOf, limited_by: LimitedBy,
    ripple_of: RippleOf, state: np.ndarray, effort: np.ndarray, brakes: np.ndarray, model: np.record, work: np.record,
) -> None:  # fmt: skip
    """Find the joint accelerations (n,) at this instant, into work.acceleration.

    A joint at rest that its friction holds has none.
    """
    n = len(work.position)
    read_state(imus, len(axis_joints), state, model, work)
    load_instant(axis_joints, 4 * n + 6 * imus + 1, limited_by, ripple_of, state, effort, brakes, model, work)
    for i in range(n):
        work.query_position[i] = work.position[i]
        work.query_speed[i] = work.speed[i]
    work.query_time_s = work.time_s
    equations(model, work)
    invert(work.mass, work.pivots, work.inverse)
    for i in range(n):
        spring = model.stiffness[i] * (work.position[i] - model.rest_position[i])
        work.force[i] = work.effort[i] - work.bias[i] - spring - model.damping[i] * work.speed[i]
    instant_reactions(reaction_of, model, work)
    multiply(work.inverse, work.force, work.acceleration)
    for j in range(n):
        work.friction[j] = 0.0
    for row in range(model.shared_count):
        work.shared[row] = 0.0
    for _ in range(SHARED_SWEEPS if model.shared_count > 0 else SWEEPS):
        for row in range(model.shared_count):
            share_instant(row, friction_of, model, work)
        for j in range(n):
            if not rubs(j, model, work):
                continue
            drive = work.acceleration[j] / work.inverse[j, j] - work.friction[j]
            if abs(work.speed[j]) > STUCK_SPEED:
                direction = 1.0 if work.speed[j] > 0.0 else -1.0
                friction = -direction * friction_level(j, abs(work.speed[j]), direction, friction_of, model, work)
            else:
                onward = 1.0 if drive > 0.0 else -1.0
                friction = -onward * min(abs(drive), friction_level(j, 0.0, onward, friction_of, model, work))
            change = friction - work.friction[j]
            work.friction[j] = friction
            for i in range(n):
                work.acceleration[i] += work.inverse[j, i] * change


@compiled
def share_instant(row: int, friction_of: FrictionOf, model: np.record, work: np.record) -> None:
    """Find the effort of a shared friction at this instant, and correct the accelerations."""
    i, k, share = model.shared_joints[row, 0], model.shared_joints[row, 1], model.share[row]
    inverse = work.inverse[i, i] + 2.0 * share * work.inverse[i, k] + share * share * work.inverse[k, k]
    drive = (work.acceleration[i] + share * work.acceleration[k]) / inverse - work.shared[row]
    speed = shared_speed(row, work.speed, model)
    if speed != 0.0:
        direction = 1.0 if speed > 0.0 else -1.0
        effort = -direction * shared_level(row, abs(speed), direction, friction_of, model, work)
    else:
        onward = 1.0 if drive > 0.0 else -1.0
        effort = -onward * min(abs(drive), shared_level(row, 0.0, onward, friction_of, model, work))
    change = effort - work.shared[row]
    work.shared[row] = effort
    for m in range(len(work.position)):
        work.acceleration[m] += (work.inverse[i, m] + share * work.inverse[k, m]) * change


@compiled
def imu_reading(
    axis_joints: tuple[int, ...], imus: int, equations: Equations, friction_of: FrictionOf, reaction_of: ReactionOf, limited_by: LimitedBy,
    ripple_of: RippleOf, imu: Equations, state: np.ndarray, effort: np.ndarray, brakes: np.ndarray, model: np.record, work: np.record,
    reading: np.ndarray,
) -> None:  # fmt: skip
    """Find specific forces and angular rates (6 imus,) at this instant, after the channels' low passes, into `reading`."""
    n = len(work.position)
    unfiltered = False
    for k in range(6 * imus):
        reading[k] = state[4 * n + k]
        unfiltered = unfiltered or model.is_filtered[k] == 0
    if not unfiltered:
        return
    joint_acceleration(axis_joints, imus, equations, friction_of, reaction_of, limited_by, ripple_of, state, effort, brakes, model, work)
    read_imus(imu, work.position, work.speed, work.acceleration, model, work)
    for k in range(6 * imus):
        if model.is_filtered[k] == 0:
            reading[k] = work.reading[k]
