"""Friction over a time step, solved implicitly: one constant effort per joint that has the effect of the friction law."""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.motion import FrictionOf, JointState, ReactionOf
from virtual_bus.plant.reactions import solve_reaction

SWEEPS = 4  # Gauss-Seidel over the joints with friction; the inertia couples them weakly, so two sweeps are mostly enough
SHARED_SWEEPS = 40  # where a friction acts on two joints that have their own: it is at half a right angle to both
SETTLED_SPEED = 1e-11  # rad/s or m/s: the largest change of a sweep that ends the search
STUCK_SPEED = 1e-9  # rad/s or m/s: a slower joint is at rest, its speed is what the sweeps have left over


@compiled
def rubs(j: int, model: np.record, work: np.record) -> bool:
    """Return whether a closed brake or a friction effect acts at joint j."""
    acts: bool = work.brake[j] > 0.0 or model.friction_first[j + 1] > model.friction_first[j]
    return acts


@compiled
def friction_level(j: int, speed: float, direction: float, friction_of: FrictionOf, model: np.record, work: np.record) -> float:
    """Return the effort [Nm or N] that opposes motion of joint j.

    `speed` is a magnitude. At 0 the level is the most that the joint holds against that direction.
    """
    wound = model.passive_stiffness[j] * (work.position[j] - model.rest_position[j])
    motor = work.effort[j] - wound - model.damping[j] * speed * direction
    state = JointState(speed, direction, work.position[j], work.bias[j], motor)
    total: float = work.brake[j]
    for row in range(model.friction_first[j], model.friction_first[j + 1]):
        total += friction_of(int(model.friction_rows[row, 0]), state, model.friction_rows[row])
    return max(total, 0.0)  # one that is lower at rest may take away no more than the others have


@compiled
def mean_friction(
    j: int, start: float, drive: float, response: float, kinetic: float, friction_of: FrictionOf, model: np.record, work: np.record
) -> float:
    """Return the constant friction effort of one joint that does over a step what the friction law does.

    The joint slides throughout, or comes to rest and stays, or turns within the step; the law decides which.

    Parameters
    ----------
    start
        Speed at the beginning of the step.
    drive
        Mean of all other effort on the joint.
    response
        Change of the joint's speed per unit of effort.
    kinetic
        Friction level at the middle of the step.
    """
    if slides(start, drive, response, kinetic):
        return -kinetic if start > 0.0 else kinetic
    return slowed(start, drive, response, kinetic, friction_level(j, 0.0, 1.0 if drive > 0.0 else -1.0, friction_of, model, work))


@compiled
def slides(start: float, drive: float, response: float, kinetic: float) -> bool:
    """Return whether what moves slides on throughout a step."""
    direction = 1.0 if start > 0.0 else -1.0
    return start != 0.0 and (start + response * (drive - direction * kinetic)) * direction > 0.0


@compiled
def slowed(start: float, drive: float, response: float, kinetic: float, holds: float) -> float:
    """Return the mean friction of what does not slide on; `holds` is the most that holds it at rest."""
    onward = 1.0 if drive > 0.0 else -1.0
    if abs(drive) <= holds:
        return -start / response - drive  # comes to rest within the step, or stays at rest
    if start == 0.0:
        return -onward * kinetic  # breaks away
    direction = 1.0 if start > 0.0 else -1.0
    share = start / (response * (direction * kinetic - drive))  # of the step until it turns
    return -direction * kinetic * share - onward * kinetic * (1.0 - share)


@compiled
def kinetic_level(j: int, friction_of: FrictionOf, model: np.record, work: np.record) -> float:
    """Return the friction level of joint j at its mean speed over the step, before the step's friction is corrected."""
    start = work.start_speed[j]
    middle = 0.5 * (start + work.speed[j])
    if start * middle < 0.0:
        middle = 0.0  # it turns, or friction stops it: what counts is the level at low speed
    direction = 1.0 if (start if start != 0.0 else middle) >= 0.0 else -1.0
    return friction_level(j, abs(middle), direction, friction_of, model, work)


@compiled
def shared_speed(row: int, speeds: np.ndarray, model: np.record) -> float:
    """Return the speed that a shared friction acts against; nothing where it is as good as at rest."""
    speed: float = speeds[model.shared_joints[row, 0]] + model.share[row] * speeds[model.shared_joints[row, 1]]
    return speed if abs(speed) > STUCK_SPEED else 0.0


@compiled
def shared_level(row: int, speed: float, direction: float, friction_of: FrictionOf, model: np.record, work: np.record) -> float:
    """Return the effort [Nm or N] of a shared friction against its speed, as `friction_level` does of a joint's own."""
    j = model.shared_joints[row, 0]
    state = JointState(speed, direction, work.position[j], work.bias[j], work.effort[j])
    return friction_of(int(model.shared_rows[row, 0]), state, model.shared_rows[row])


@compiled
def shared_kinetic(row: int, friction_of: FrictionOf, model: np.record, work: np.record) -> float:
    """Return the level of a shared friction at its mean speed over the step, as far as that is found yet."""
    start = shared_speed(row, work.start_speed, model)
    middle = 0.5 * (start + shared_speed(row, work.speed, model))
    if start * middle < 0.0:
        middle = 0.0
    direction = 1.0 if (start if start != 0.0 else middle) >= 0.0 else -1.0
    return shared_level(row, abs(middle), direction, friction_of, model, work)


@compiled
def settle_shared(row: int, friction_of: FrictionOf, model: np.record, work: np.record) -> float:
    """Find the effort of a shared friction beside all others, and return by how much that changes its speed."""
    i, k, share = model.shared_joints[row, 0], model.shared_joints[row, 1], model.share[row]
    by = work.speed_response
    response = by[i, i] + share * (by[i, k] + by[k, i]) + share * share * by[k, k]
    start = shared_speed(row, work.start_speed, model)
    end = work.speed[i] + share * work.speed[k]
    drive = (end - start) / response - work.shared[row]
    kinetic = shared_kinetic(row, friction_of, model, work)
    if slides(start, drive, response, kinetic):
        effort = -kinetic if start > 0.0 else kinetic
    else:
        holds = shared_level(row, 0.0, 1.0 if drive > 0.0 else -1.0, friction_of, model, work)
        effort = slowed(start, drive, response, kinetic, holds)
    change = effort - work.shared[row]
    work.shared[row] = effort
    work.friction_change[i] += change
    work.friction_change[k] += share * change
    for m in range(len(work.position)):
        work.speed[m] += (by[i, m] + share * by[k, m]) * change
    moved: float = abs(change * response)
    return moved


@compiled
def settle(friction_of: FrictionOf, reaction_of: ReactionOf, h: float, model: np.record, work: np.record) -> None:
    """Find the efforts of friction and of effects with a memory over a step, and correct the speeds at its end.

    work.friction and work.reaction hold the efforts that the step assumed and then the ones found; work.friction_change holds the change of
    both together.
    """
    n = len(work.position)
    for j in range(n):
        work.friction_change[j] = 0.0
        if abs(work.start_speed[j]) < STUCK_SPEED:
            work.start_speed[j] = 0.0
        if rubs(j, model, work):
            work.kinetic[j] = kinetic_level(j, friction_of, model, work)
    for row in range(model.shared_count):
        work.shared[row] = 0.0
    for _ in range(SHARED_SWEEPS if model.shared_count > 0 else SWEEPS):
        largest = 0.0
        for row in range(model.shared_count):
            largest = max(largest, settle_shared(row, friction_of, model, work))
        for j in range(n):
            if rubs(j, model, work):
                start, response = work.start_speed[j], work.speed_response[j, j]
                drive = (work.speed[j] - start) / response - work.friction[j]
                change = mean_friction(j, start, drive, response, work.kinetic[j], friction_of, model, work) - work.friction[j]
                work.friction[j] += change
                work.friction_change[j] += change
                for i in range(n):
                    work.speed[i] += work.speed_response[j, i] * change
                largest = max(largest, abs(change * response))
        for row in range(model.reaction_count):
            largest = max(largest, solve_reaction(row, reaction_of, h, model, work))
        if largest < SETTLED_SPEED:
            break


@compiled
def rub(friction_of: FrictionOf, reaction_of: ReactionOf, h: float, model: np.record, work: np.record) -> None:
    """Correct a step's end for friction and effects with a memory, in place."""
    settle(friction_of, reaction_of, h, model, work)
    n = len(work.position)
    for j in range(n):
        change = work.friction_change[j]
        if change != 0.0:
            for i in range(n):
                work.position[i] += work.position_response[j, i] * change
                work.acceleration[i] += work.inverse[j, i] * change
                work.start_acceleration[i] += work.inverse[j, i] * change
