"""What a plant shows at an instant: joint accelerations under the effort that acts from now on, and the IMUs without noise."""

from __future__ import annotations

from virtual_bus.plant.friction import STUCK_SPEED, SWEEPS, friction_level, rubs
from virtual_bus.plant.integrator import load_joints, read_imus, read_state
from virtual_bus.plant.jit import compiled
from virtual_bus.plant.linear import invert, multiply


@compiled
def joint_acceleration(axis_joints, imus, mass_and_bias, effect_level, state, effort, brakes, model, work):
    """Joint accelerations (n,) at this instant, into work.acceleration. A joint at rest that its friction holds has none."""
    n = len(work.position)
    read_state(imus, state, work)
    load_joints(axis_joints, effort, brakes, model, work)
    for i in range(n):
        work.query_position[i] = work.position[i]
        work.query_speed[i] = work.speed[i]
    mass_and_bias(model, work)
    invert(work.mass, work.pivots, work.inverse)
    for i in range(n):
        spring = model.stiffness[i] * (work.position[i] - model.rest_position[i])
        work.force[i] = work.effort[i] - work.bias[i] - spring - model.damping[i] * work.speed[i]
    multiply(work.inverse, work.force, work.acceleration)
    for j in range(n):
        work.friction[j] = 0.0
    for _ in range(SWEEPS):
        for j in range(n):
            if not rubs(j, model, work):
                continue
            drive = work.acceleration[j] / work.inverse[j, j] - work.friction[j]
            if abs(work.speed[j]) > STUCK_SPEED:
                direction = 1.0 if work.speed[j] > 0.0 else -1.0
                friction = -direction * friction_level(j, abs(work.speed[j]), direction, effect_level, model, work)
            else:
                onward = 1.0 if drive > 0.0 else -1.0
                friction = -onward * min(abs(drive), friction_level(j, 0.0, onward, effect_level, model, work))
            change = friction - work.friction[j]
            work.friction[j] = friction
            for i in range(n):
                work.acceleration[i] += work.inverse[j, i] * change


@compiled
def imu_reading(axis_joints, imus, mass_and_bias, effect_level, imu, state, effort, brakes, model, work, reading):
    """Specific forces and angular rates (6 imus,) at this instant, after the channels' low passes, into `reading`."""
    n = len(work.position)
    unfiltered = False
    for k in range(6 * imus):
        reading[k] = state[4 * n + k]
        unfiltered = unfiltered or model.is_filtered[k] == 0
    if not unfiltered:
        return
    joint_acceleration(axis_joints, imus, mass_and_bias, effect_level, state, effort, brakes, model, work)
    read_imus(imu, work.position, work.speed, work.acceleration, model, work)
    for k in range(6 * imus):
        if model.is_filtered[k] == 0:
            reading[k] = work.reading[k]
