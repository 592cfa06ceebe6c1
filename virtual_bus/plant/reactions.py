"""Effects with a memory over a time step, solved implicitly.

Each effect gets one constant effort: the one that its law asks for at the motion that this very effort brings about.
"""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.motion import ReactionOf, ReactionState

ITERATIONS = 40  # of the secant rule on one effort; two or three are mostly enough
HALVED_FROM = 4  # from this try on every second one halves the bracket: stiff bristles about to slip bend the secant to one side
SETTLED_SPEED = 1e-13  # rad/s or m/s: the largest change of an iteration that ends the search
PROBE_SPEED = 1e-7  # rad/s or m/s: the least change of speed over which a slope is taken
INSTANT_s = 1e-7  # a step so short that nothing moves within it


@compiled
def begin_reactions(model: np.record, work: np.record) -> None:
    """Begin the step with the efforts of the last one."""
    for row in range(model.reaction_count):
        work.reaction_guess[row] = work.reaction[row]
        work.load[model.reaction_joint[row]] += work.reaction[row]


@compiled
def reaction_state(row: int, end_speed: float, h: float, model: np.record, work: np.record) -> ReactionState:
    """Return what the hook of an effect is told."""
    j = model.reaction_joint[row]
    return ReactionState(work.memory[row, 0], work.memory[row, 1], work.start_position[j], work.start_speed[j], end_speed, h)


@compiled
def solve_reaction(row: int, reaction_of: ReactionOf, h: float, model: np.record, work: np.record) -> float:
    """Correct a step's end for one effect, in place, and return how far the joint's speed changed."""
    j = model.reaction_joint[row]
    number = int(model.reaction_rows[row, 0])
    response: float = work.speed_response[j, j]
    assumed: float = work.reaction[row]
    effort, slope, low, high = assumed, 0.0, -math.inf, math.inf
    asked_before, speed_before = 0.0, 0.0
    for number_of_try in range(ITERATIONS):
        end_speed = work.speed[j] + response * (effort - assumed)
        asked = reaction_of(number, reaction_state(row, end_speed, h, model, work), model.reaction_rows[row])[0]
        if abs((asked - effort) * response) < SETTLED_SPEED:
            effort = asked
            break
        if asked > effort:
            low = effort
        else:
            high = effort
        moved = end_speed - speed_before
        if number_of_try == 0:
            moved = max(PROBE_SPEED, 1e-4 * abs(end_speed))
            beside = reaction_of(number, reaction_state(row, end_speed + moved, h, model, work), model.reaction_rows[row])[0]
            slope = min((beside - asked) / moved, 0.0)
        elif abs(moved) > PROBE_SPEED:  # a smaller difference is mostly rounding, and the slope hardly changes there
            slope = min((asked - asked_before) / moved, 0.0)
        asked_before, speed_before = asked, end_speed
        effort += (asked - effort) / (1.0 - response * slope)
        is_slow = number_of_try >= HALVED_FROM and number_of_try % 2 == 1
        if high - low < math.inf and (is_slow or not low < effort < high):  # the slope belongs to the other side of a reversal
            effort = 0.5 * (low + high)
    change = effort - assumed
    work.reaction[row] = effort
    work.friction_change[j] += change
    for i in range(len(work.speed)):
        work.speed[i] += work.speed_response[j, i] * change
    return abs(change * response)


@compiled
def end_reactions(reaction_of: ReactionOf, h: float, model: np.record, work: np.record) -> None:
    """Move the effects' states to the step's end."""
    for row in range(model.reaction_count):
        j = model.reaction_joint[row]
        state = reaction_state(row, work.speed[j], h, model, work)
        _, work.memory[row, 0], work.memory[row, 1] = reaction_of(int(model.reaction_rows[row, 0]), state, model.reaction_rows[row])
        work.load[j] -= work.reaction_guess[row]


@compiled
def instant_reactions(reaction_of: ReactionOf, model: np.record, work: np.record) -> None:
    """Add the effects' efforts at this instant to work.force."""
    for row in range(model.reaction_count):
        j = model.reaction_joint[row]
        work.start_position[j] = work.position[j]
        work.start_speed[j] = work.speed[j]
        state = reaction_state(row, work.speed[j], INSTANT_s, model, work)
        work.force[j] += reaction_of(int(model.reaction_rows[row, 0]), state, model.reaction_rows[row])[0]
