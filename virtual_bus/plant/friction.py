"""Friction over a time step, solved implicitly: one constant effort per joint that has the effect of the friction law."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.motion import FrictionOf, JointState, ReactionOf
from virtual_bus.plant.jit import compiled
from virtual_bus.plant.reactions import solve_reaction

SWEEPS = 4  # Gauss-Seidel over the joints with friction; the inertia couples them weakly, so two sweeps are mostly enough
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
    motor = abs(work.effort[j] - model.damping[j] * speed * direction)
    state = JointState(speed, direction, work.position[j], abs(work.bias[j]), motor)
    total: float = work.brake[j]
    for row in range(model.friction_first[j], model.friction_first[j + 1]):
        total += friction_of(int(model.friction_rows[row, 0]), state, model.friction_rows[row])
    return total


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
    onward = 1.0 if drive > 0.0 else -1.0
    if start != 0.0:
        direction = 1.0 if start > 0.0 else -1.0
        if (start + response * (drive - direction * kinetic)) * direction > 0.0:
            return -direction * kinetic  # slides throughout
    if abs(drive) <= friction_level(j, 0.0, onward, friction_of, model, work):
        return -start / response - drive  # comes to rest within the step, or stays at rest
    if start == 0.0:
        return -onward * kinetic  # breaks away
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
    for _ in range(SWEEPS):
        largest = 0.0
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
