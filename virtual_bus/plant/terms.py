"""Terms that effects add to the equations of motion at one instant: efforts, inertia, and the velocity terms of that inertia."""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.motion import EffortOf, JointMotion, PairMotion, TermsOf


@compiled
def add_efforts(effort_of: EffortOf, model: np.record, work: np.record) -> None:
    """Subtract the efforts on single joints from the bias."""
    for row in range(model.effort_count):
        j = model.effort_joint[row]
        position = work.query_position[j]
        motion = JointMotion(
            position, work.query_speed[j], work.query_time_s, model.effort_ratio[row], model.stiffness[j], position - model.rest_position[j]
        )
        work.bias[j] -= effort_of(int(model.effort_rows[row, 0]), motion, model.effort_rows[row])


@compiled
def add_pairs(terms_of: TermsOf, model: np.record, work: np.record) -> None:
    """Add the terms between two joints: inertia into the lower half, efforts off the bias."""
    for row in range(model.pair_count):
        i, j = model.pair_joints[row, 0], model.pair_joints[row, 1]
        rest = model.rest_position[j] if model.pair_is_spring[row] else 0.0
        pair = PairMotion(
            work.query_position[i], work.query_speed[i], work.query_position[j] - rest, work.query_speed[j],
            model.pair_ratio[row], model.stiffness[j],
        )  # fmt: skip
        inertia, coupling, effort, other_effort = terms_of(int(model.pair_rows[row, 0]), pair, model.pair_rows[row])
        work.mass[i, i] += inertia
        work.mass[max(i, j), min(i, j)] += coupling
        work.bias[i] -= effort
        work.bias[j] -= other_effort
