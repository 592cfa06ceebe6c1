"""What a plant shows at an instant: joint accelerations under the effort that acts from now on, and the IMUs without noise."""

from __future__ import annotations

from virtual_bus.plant.integrator import FRICTION_SWEEPS, STUCK_SPEED, friction_level, invert, load_joints, multiply, rubs
from virtual_bus.plant.jit import compiled


@compiled
def joint_acceleration(joints, axis_joints, mass_and_bias, effect_level, state, effort, brakes, model, work):
    """Joint accelerations (n,) at this instant, into `work.derivative`. A joint at rest that its friction holds has none."""
    n = len(joints)
    position, speed = state[0:n], state[n : 2 * n]
    load_joints(joints, axis_joints, effort, brakes, model, work)
    mass_and_bias(position, speed, model.constants, work.mass, work.bias)
    invert(joints, work.mass, work.pivots, work.inverse)
    for i in range(n):
        spring = model.stiffness[i] * (position[i] - model.rest_position[i])
        work.force[i] = work.effort[i] - work.bias[i] - spring - model.damping[i] * speed[i]
    acceleration = work.derivative
    multiply(joints, work.inverse, work.force, acceleration)
    for j in range(n):
        work.friction_change[j] = 0.0
    for _ in range(FRICTION_SWEEPS):
        for j in range(n):
            if not rubs(j, model, work):
                continue
            drive = acceleration[j] / work.inverse[j, j] - work.friction_change[j]
            if abs(speed[j]) > STUCK_SPEED:
                direction = 1.0 if speed[j] > 0.0 else -1.0
                friction = -direction * friction_level(j, abs(speed[j]), direction, position[j], model, work, effect_level)
            else:
                onward = 1.0 if drive > 0.0 else -1.0
                holding = friction_level(j, 0.0, onward, position[j], model, work, effect_level)
                friction = -onward * min(abs(drive), holding)
            change = friction - work.friction_change[j]
            work.friction_change[j] = friction
            for i in range(n):
                acceleration[i] += work.inverse[j, i] * change


@compiled
def imu_reading(joints, axis_joints, mass_and_bias, effect_level, imu, state, effort, brakes, model, work, reading):
    """Specific forces and angular rates (6 imus,) at this instant, after the channels' low passes, into `reading`."""
    n = len(joints)
    filtered = state[4 * n :]
    unfiltered = False
    for k in range(len(filtered)):
        reading[k] = filtered[k]
        unfiltered = unfiltered or not model.is_filtered[k]
    if not unfiltered:
        return
    joint_acceleration(joints, axis_joints, mass_and_bias, effect_level, state, effort, brakes, model, work)
    imu(state[0:n], state[n : 2 * n], work.derivative, model.constants, work.reading)
    for k in range(len(filtered)):
        if not model.is_filtered[k]:
            reading[k] = work.reading[k]
