"""Effects with a memory over a time step: the one constant effort whose own effect on the joint's speed asks for it, found implicitly."""

from __future__ import annotations

from virtual_bus.effects.motion import ReactionState
from virtual_bus.plant.jit import compiled

ITERATIONS = 12  # of Newton's rule on one effort; two or three mostly do
SETTLED_SPEED = 1e-13  # rad/s or m/s: what a further iteration may still change
PROBE_SPEED = 1e-7  # least change of speed [rad/s or m/s] that a slope is taken over
INSTANT_s = 1e-7  # a step so short that nothing moves in it


@compiled
def begin_reactions(model, work):
    """Let the step begin with the efforts of the last one."""
    for row in range(model.reaction_count):
        work.reaction_guess[row] = work.reaction[row]
        work.load[model.reaction_joint[row]] += work.reaction[row]


@compiled
def reaction_state(row, end_speed, h, model, work):
    """What an effect's hook is told."""
    j = model.reaction_joint[row]
    return ReactionState(work.memory[row, 0], work.memory[row, 1], work.start_position[j], work.start_speed[j], end_speed, h)


@compiled
def solve_reaction(row, reaction_of, h, model, work):
    """Correct a step's end for one effect, in place; returns how far the joint's speed changed."""
    j = model.reaction_joint[row]
    number = int(model.reaction_rows[row, 0])
    response = work.speed_response[j, j]
    assumed = work.reaction[row]
    effort = assumed
    for _ in range(ITERATIONS):
        end_speed = work.speed[j] + response * (effort - assumed)
        probe = max(PROBE_SPEED, 1e-4 * abs(end_speed))
        asked = reaction_of(number, reaction_state(row, end_speed, h, model, work), model.reaction_rows[row])[0]
        beside = reaction_of(number, reaction_state(row, end_speed + probe, h, model, work), model.reaction_rows[row])[0]
        slope = min((beside - asked) / probe, 0.0)
        change = (asked - effort) / (1.0 - response * slope)
        effort += change
        if abs(change * response) < SETTLED_SPEED:
            break
    change = effort - assumed
    work.reaction[row] = effort
    work.friction_change[j] += change
    for i in range(len(work.speed)):
        work.speed[i] += work.speed_response[j, i] * change
    return abs(change * response)


@compiled
def end_reactions(reaction_of, h, model, work):
    """Move the effects' states to the step's end."""
    for row in range(model.reaction_count):
        j = model.reaction_joint[row]
        state = reaction_state(row, work.speed[j], h, model, work)
        _, work.memory[row, 0], work.memory[row, 1] = reaction_of(int(model.reaction_rows[row, 0]), state, model.reaction_rows[row])
        work.load[j] -= work.reaction_guess[row]


@compiled
def instant_reactions(reaction_of, model, work):
    """Efforts at this instant, onto work.force."""
    for row in range(model.reaction_count):
        j = model.reaction_joint[row]
        work.start_position[j] = work.position[j]
        work.start_speed[j] = work.speed[j]
        state = reaction_state(row, work.speed[j], INSTANT_s, model, work)
        work.force[j] += reaction_of(int(model.reaction_rows[row, 0]), state, model.reaction_rows[row])[0]
