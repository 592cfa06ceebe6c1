"""One plant step: slow equations at the midpoint, stiff linear part by a Taylor flow, friction implicitly. See docs/plant.md.

The functions are compiled for one plant: `joints` is a tuple as long as the plant has joints, so that loops over it have a length known to the
compiler, and the plant's own equations are handed in as compiled functions. A joint whose speed is v feels, over a step,

    M(q) v' = load - bias(q, v) - K (q - rest) - D v + friction.
"""

from __future__ import annotations

from virtual_bus.effects.effect import JointState
from virtual_bus.plant.jit import compiled

TAYLOR_ORDER = 8  # stable up to 3.4 times the step at the highest natural frequency, its error (wh)^9/9! per step
FRICTION_SWEEPS = 3  # Gauss-Seidel over the joints that rub; their mutual coupling through M is weak
STUCK_SPEED = 1e-12  # rad/s or m/s: slower is rounding, the joint is at rest


@compiled
def invert(joints, mass, pivots, inverse):
    """Inverse of the symmetric positive definite `mass` (lower half given) by its L D Lᵀ factors. `mass` is overwritten."""
    n = len(joints)
    for j in range(n):
        for i in range(j, n):
            total = mass[i, j]
            for k in range(j):
                total -= mass[i, k] * mass[j, k] * pivots[k]
            if i == j:
                pivots[j] = total
                mass[j, j] = 1.0 / total
            else:
                mass[i, j] = total * mass[j, j]
    for j in range(n):  # columns of the inverse of L, in the upper half's place
        for i in range(j + 1, n):
            total = -mass[i, j]
            for k in range(j + 1, i):
                total -= mass[i, k] * mass[j, k]
            mass[j, i] = total
    for i in range(n):
        for j in range(i + 1):
            total = mass[i, i] if i == j else mass[j, i] * mass[i, i]
            for k in range(i + 1, n):
                total += mass[i, k] * mass[j, k] * mass[k, k]
            inverse[i, j] = total
            inverse[j, i] = total


@compiled
def multiply(joints, matrix, vector, product):
    for i in range(len(joints)):
        total = 0.0
        for j in range(len(joints)):
            total += matrix[i, j] * vector[j]
        product[i] = total


@compiled
def flow(joints, h, model, work, position, speed, acceleration, friction):
    """Move on by h [s] at frozen inertia and bias: Taylor series of the linear equations, in place. `acceleration` is the one at the end."""
    n = len(joints)
    force, derivative, lower = work.force, work.derivative, work.lower_derivative
    for i in range(n):
        lower[i] = speed[i]
        force[i] = work.load[i] + friction[i] - model.stiffness[i] * (position[i] - model.rest_position[i]) - model.damping[i] * speed[i]
        position[i] += h * speed[i]
        acceleration[i] = 0.0
    weight = 1.0  # h^(k-1) / (k-1)! of derivative k
    for k in range(1, TAYLOR_ORDER + 1):
        multiply(joints, work.inverse, force, derivative)
        speed_weight = weight * h / k
        position_weight = speed_weight * h / (k + 1)
        for i in range(n):
            acceleration[i] += weight * derivative[i]
            speed[i] += speed_weight * derivative[i]
            position[i] += position_weight * derivative[i]
            force[i] = -model.stiffness[i] * lower[i] - model.damping[i] * derivative[i]
            lower[i] = derivative[i]
        if k == 1:
            for i in range(n):
                work.start_acceleration[i] = derivative[i]
        weight = speed_weight


@compiled
def respond(joints, j, h, model, work):
    """Change of all positions and speeds within h [s] per unit of constant effort on joint j, to third order in h."""
    n = len(joints)
    force, derivative = work.force, work.derivative
    for i in range(n):
        first = work.inverse[i, j]
        work.speed_response[j, i] = h * first
        work.position_response[j, i] = h * h / 2.0 * first
        force[i] = -model.damping[i] * first
    multiply(joints, work.inverse, force, derivative)
    for i in range(n):
        work.speed_response[j, i] += h * h / 2.0 * derivative[i]
        work.position_response[j, i] += h * h * h / 6.0 * derivative[i]
        force[i] = -model.stiffness[i] * work.inverse[i, j] - model.damping[i] * derivative[i]
    multiply(joints, work.inverse, force, derivative)
    for i in range(n):
        work.speed_response[j, i] += h * h * h / 6.0 * derivative[i]


@compiled
def friction_level(j, speed, direction, position, model, work, effect_level):
    """Effort [Nm or N] that opposes motion of joint j: `speed` is a magnitude; at 0, the most the joint holds against that direction."""
    state = JointState(speed, direction, position)
    total = work.brake[j]
    for row in range(model.friction_first[j], model.friction_first[j + 1]):
        total += effect_level(int(model.friction_rows[row, 0]), state, model.friction_rows[row])
    return total


@compiled
def mean_friction(j, start, drive, response, position, model, work, effect_level):
    """Constant friction effort that does over a step what the friction law does, of a joint alone.

    Parameters: `start` speed at the step's begin, `drive` the mean of all other effort on the joint, `response` change of its speed per unit of
    effort. The joint slides throughout, or comes to rest and stays, or turns within the step; which one follows from the law.
    """
    onward = 1.0 if drive > 0.0 else -1.0
    direction = onward
    if start != 0.0:
        direction = 1.0 if start > 0.0 else -1.0
    kinetic = friction_level(j, abs(start), direction, position, model, work, effect_level)
    end = start + response * (drive - direction * kinetic)
    middle = 0.5 * (start + end)
    if middle * direction > 0.0:
        kinetic = friction_level(j, abs(middle), direction, position, model, work, effect_level)
        end = start + response * (drive - direction * kinetic)
    if start != 0.0 and end * direction > 0.0:
        return -direction * kinetic  # slides throughout
    if abs(drive) <= friction_level(j, 0.0, onward, position, model, work, effect_level):
        return -start / response - drive  # comes to rest within the step, or stays at rest
    if start == 0.0:
        return -onward * kinetic  # breaks away
    share = start / (response * (direction * kinetic - drive))  # of the step until it turns
    return -direction * kinetic * share - onward * kinetic * (1.0 - share)


@compiled
def rubs(j, model, work):
    """Does anything rub at joint j: a closed brake or a friction effect?"""
    return work.brake[j] > 0.0 or model.friction_first[j + 1] > model.friction_first[j]


@compiled
def rub(joints, model, work, effect_level, position, speed, acceleration, friction):
    """Correct a step's end for friction, in place; `friction` holds what the step assumed and then what it was."""
    n = len(joints)
    for j in range(n):
        work.friction_change[j] = 0.0
    for _ in range(FRICTION_SWEEPS):
        largest = 0.0
        for j in range(n):
            if rubs(j, model, work):
                response = work.speed_response[j, j]
                start = work.start_speed[j]
                if abs(start) < STUCK_SPEED:
                    start = 0.0
                drive = (speed[j] - start) / response - friction[j]
                change = mean_friction(j, start, drive, response, position[j], model, work, effect_level) - friction[j]
                friction[j] += change
                work.friction_change[j] += change
                for i in range(n):
                    speed[i] += work.speed_response[j, i] * change
                largest = max(largest, abs(change * response))
        if largest < STUCK_SPEED:
            break
    for j in range(n):
        change = work.friction_change[j]
        if change != 0.0:
            for i in range(n):
                position[i] += work.position_response[j, i] * change
                acceleration[i] += work.inverse[j, i] * change
                work.start_acceleration[i] += work.inverse[j, i] * change


@compiled
def load_joints(joints, axis_joints, effort, brakes, model, work):
    """Spread the drives' efforts and the brakes over the joints."""
    for i in range(len(joints)):
        work.effort[i] = 0.0
        work.brake[i] = 0.0
    for axis in range(len(axis_joints)):
        j = axis_joints[axis]
        work.effort[j] += model.effort_gain[axis] * effort[axis]
        work.brake[j] += model.brake_effort[j] * brakes[axis]


@compiled
def advance_one(joints, mass_and_bias, effect_level, position, speed, acceleration, friction, model, work):
    """One plant step of `model.step_s`. `acceleration` is the one at the end of the last step, and then of this one."""
    n = len(joints)
    h = model.step_s
    for i in range(n):
        work.position[i] = position[i] + 0.5 * h * (speed[i] + 0.25 * h * acceleration[i])
        work.speed[i] = speed[i] + 0.5 * h * acceleration[i]
    mass_and_bias(work.position, work.speed, model.constants, work.mass, work.bias)
    invert(joints, work.mass, work.pivots, work.inverse)
    any_friction = False
    inner = h / model.inner_steps
    for j in range(n):
        work.load[j] = work.effort[j] - work.bias[j]
        if rubs(j, model, work):
            any_friction = True
            respond(joints, j, inner, model, work)
        else:
            friction[j] = 0.0
    for part in range(model.inner_steps):
        for j in range(n):
            work.start_speed[j] = speed[j]
        flow(joints, inner, model, work, position, speed, acceleration, friction)
        if any_friction:
            rub(joints, model, work, effect_level, position, speed, acceleration, friction)
        if part == 0:
            for i in range(n):
                work.first_acceleration[i] = work.start_acceleration[i]


@compiled
def advance(joints, axis_joints, mass_and_bias, effect_level, imu, state, effort, brakes, model, work):
    """One sample: `model.steps` plant steps at constant drive effort, and the IMUs' low passes along with them."""
    n = len(joints)
    position, speed, acceleration, friction = state[0:n], state[n : 2 * n], state[2 * n : 3 * n], state[3 * n : 4 * n]
    filtered = state[4 * n :]
    load_joints(joints, axis_joints, effort, brakes, model, work)
    if len(filtered) == 0:
        for _ in range(model.steps):
            advance_one(joints, mass_and_bias, effect_level, position, speed, acceleration, friction, model, work)
        return
    for step in range(model.steps):
        if step == 0:
            for i in range(n):
                work.first_position[i] = position[i]
                work.first_speed[i] = speed[i]
        advance_one(joints, mass_and_bias, effect_level, position, speed, acceleration, friction, model, work)
        if step == 0:  # the drives' effort has just changed, and with it the acceleration: the last sample's end is not this one's start
            imu(work.first_position, work.first_speed, work.first_acceleration, model.constants, work.reading)
        imu(position, speed, acceleration, model.constants, work.end_reading)
        for k in range(len(filtered)):
            weights = model.filter_weights[k]
            filtered[k] = weights[0] * filtered[k] + weights[1] * work.reading[k] + weights[2] * work.end_reading[k]
            work.reading[k] = work.end_reading[k]
