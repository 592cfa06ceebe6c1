"""One sample of LANES machines of one plant at a time: `integrator.advance` for a record of lanes.

What branches on a machine's own numbers is done for the machines that have it, one after the other, in records of their own: friction and
effects with a memory, terms of effects, and drives that do more than pass their targets on. See lanes.py.

`side` is always a record of lanes. Beside the records of all machines, `models`, `model` is one too; beside a `lane` it is that machine's
own.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.motion import EffortOf, FrictionOf, LimitedBy, ReactionOf, RippleOf, TermsOf
from virtual_bus.plant.drives import drive_joints, remember_targets
from virtual_bus.plant.friction import rubs, settle
from virtual_bus.plant.integrator import flow, read_imus, respond, second_order
from virtual_bus.plant.lanes import LaneRecord
from virtual_bus.plant.linear import invert
from virtual_bus.plant.reactions import begin_reactions, end_reactions
from virtual_bus.plant.records import Equations
from virtual_bus.plant.terms import add_efforts, add_pairs


class Acting(Protocol):
    """Lanes whose machines have something of their own, each kind in ascending order."""

    @property
    def terms(self) -> np.ndarray:
        """Lanes with terms of effects."""

    @property
    def memories(self) -> np.ndarray:
        """Lanes with effects that have a memory."""

    @property
    def frictions(self) -> np.ndarray:
        """Lanes with friction or an effect with a memory."""

    @property
    def drives(self) -> np.ndarray:
        """Lanes whose drives do more than pass their targets on."""

    @property
    def joints(self) -> np.ndarray:
        """Whether a lane has friction or an effect with a memory at a joint (joints,)."""


def model_record(joints: int, axes: int, imus: int, constants: int) -> LaneRecord:
    """Return the fields of `records.model_dtype` in which machines of one plant differ."""
    n, channels = joints, max(6 * imus, 1)
    return LaneRecord(
        {
            "constants": (max(constants, 1),),
            "stiffness": (n,),
            "damping": (n,),
            "rest_position": (n,),
            "effort_gain": (max(axes, 1),),
            "second_weights": (channels, 2, 4),  # of low passes of first order too: their slope stays zero
        }
    )


def work_record(joints: int, imus: int) -> LaneRecord:
    """Return scratch memory as of `records.work_dtype`, with the state in it.

    The state is position, speed, acceleration, friction, filtered and its slope.
    """
    vectors = [
        "position", "speed", "acceleration", "friction", "query_position", "query_speed", "query_acceleration", "bias", "pivots", "effort",
        "load", "force", "derivative", "lower_derivative", "start_speed", "start_acceleration",
        "first_position", "first_speed", "first_acceleration", "friction_change",
    ]  # fmt: skip
    squares = ["mass", "inverse", "position_response", "speed_response"]
    readings = ["filtered", "filtered_slope", "reading", "start_reading"]
    shapes: dict[str, tuple[int, ...]] = {name: (joints,) for name in vectors} | {name: (joints, joints) for name in squares}
    return LaneRecord(shapes | {name: (max(6 * imus, 1),) for name in readings})


@compiled
def drive_apart(
    axis_joints: tuple[int, ...], first_drive: int, step: int, limited_by: LimitedBy, ripple_of: RippleOf, lane: int, state: np.ndarray,
    effort: np.ndarray, model: np.record, side: np.record, work: np.record,
) -> None:  # fmt: skip
    """Find the efforts of one machine's drives on its joints, as `drive_joints` does."""
    for i in range(len(work.position)):
        work.position[i] = side.position[i, lane]
        work.speed[i] = side.speed[i, lane]
        work.acceleration[i] = side.acceleration[i, lane]
    drive_joints(axis_joints, first_drive, step, limited_by, ripple_of, state, effort, model, work)
    for i in range(len(work.position)):
        side.effort[i, lane] = work.effort[i]


@compiled
def add_apart(effort_of: EffortOf, terms_of: TermsOf, time_s: float, lane: int, model: np.record, side: np.record, work: np.record) -> None:
    """Add one machine's effects to its equations."""
    n = len(work.position)
    for i in range(n):
        work.query_position[i] = side.query_position[i, lane]
        work.query_speed[i] = side.query_speed[i, lane]
        work.bias[i] = side.bias[i, lane]
    if model.pair_count > 0:
        for i in range(n):
            for j in range(i + 1):
                work.mass[i, j] = side.mass[i, j, lane]
    work.query_time_s = time_s
    add_efforts(effort_of, model, work)
    add_pairs(terms_of, model, work)
    for i in range(n):
        side.bias[i, lane] = work.bias[i]
    if model.pair_count > 0:
        for i in range(n):
            for j in range(i + 1):
                side.mass[i, j, lane] = work.mass[i, j]


@compiled
def begin_apart(lane: int, model: np.record, side: np.record, work: np.record) -> None:
    """Begin one machine's inner step with the efforts its effects with a memory had at the end of the last."""
    for i in range(len(work.position)):
        work.load[i] = side.load[i, lane]
        work.start_position[i] = side.position[i, lane]
    begin_reactions(model, work)
    for i in range(len(work.position)):
        side.load[i, lane] = work.load[i]


@compiled
def settle_apart(
    friction_of: FrictionOf, reaction_of: ReactionOf, h: float, lane: int, model: np.record, side: np.record, work: np.record
) -> None:
    """Find the efforts of friction and of effects with a memory over one machine's inner step."""
    n = len(work.position)
    for i in range(n):
        work.speed[i] = side.speed[i, lane]
    for j in range(n):
        if rubs(j, model, work) or model.reacts[j]:
            work.position[j] = side.position[j, lane]
            work.start_speed[j] = side.start_speed[j, lane]
            work.bias[j] = side.bias[j, lane]
            work.effort[j] = side.effort[j, lane]
            for i in range(n):
                work.speed_response[j, i] = side.speed_response[j, i, lane]
    settle(friction_of, reaction_of, h, model, work)
    for j in range(n):
        if rubs(j, model, work) or model.reacts[j]:
            side.friction[j, lane] = work.friction[j]
            side.friction_change[j, lane] = work.friction_change[j]
    if model.reaction_count > 0:
        end_reactions(reaction_of, h, model, work)
        for i in range(n):
            side.load[i, lane] = work.load[i]


@compiled
def rub(
    friction_of: FrictionOf, reaction_of: ReactionOf, h: float, acting: Acting, models: np.ndarray, works: np.ndarray, side: np.record
) -> None:
    """Correct the end of an inner step for friction and effects with a memory."""
    for lane in acting.frictions:
        settle_apart(friction_of, reaction_of, h, lane, models[lane], side, works[lane])
    n = len(side.position)
    for j in range(n):
        if acting.joints[j]:
            change = side.friction_change[j]
            for i in range(n):
                side.speed[i] += side.speed_response[j, i] * change
                side.position[i] += side.position_response[j, i] * change
                side.acceleration[i] += side.inverse[j, i] * change
                side.start_acceleration[i] += side.inverse[j, i] * change


@compiled
def advance_one(
    mass_and_bias: Equations, friction_of: FrictionOf, reaction_of: ReactionOf, effort_of: EffortOf, terms_of: TermsOf, time_s: float,
    acting: Acting, models: np.ndarray, works: np.ndarray, model: np.record, side: np.record,
) -> None:  # fmt: skip
    """Take one plant step, as `integrator.advance_one` does."""
    n = len(side.position)
    h = models[0].step_s
    inner = h / models[0].inner_steps
    for i in range(n):
        side.query_position[i] = side.position[i] + 0.5 * h * (side.speed[i] + 0.25 * h * side.acceleration[i])
        side.query_speed[i] = side.speed[i] + 0.5 * h * side.acceleration[i]
    mass_and_bias(model, side)
    for lane in acting.terms:
        add_apart(effort_of, terms_of, time_s + 0.5 * h, lane, models[lane], side, works[lane])
    invert(side.mass, side.pivots, side.inverse)
    for j in range(n):
        side.load[j] = side.effort[j] - side.bias[j]
        if acting.joints[j]:
            respond(j, inner, model, side)
    for part in range(models[0].inner_steps):
        for j in range(n):
            side.start_speed[j] = side.speed[j]
        for lane in acting.memories:
            begin_apart(lane, models[lane], side, works[lane])
        flow(inner, model, side)
        rub(friction_of, reaction_of, inner, acting, models, works, side)
        if part == 0:
            for i in range(n):
                side.first_acceleration[i] = side.start_acceleration[i]


@compiled
def advance(
    axis_joints: tuple[int, ...], imus: int, first_drive: int, mass_and_bias: Equations, friction_of: FrictionOf, reaction_of: ReactionOf,
    effort_of: EffortOf, terms_of: TermsOf, limited_by: LimitedBy, ripple_of: RippleOf, imu: Equations, time_s: float, targets: np.ndarray,
    efforts: np.ndarray, acting: Acting, states: np.ndarray, models: np.ndarray, works: np.ndarray, model: np.record, side: np.record,
) -> None:  # fmt: skip
    """Take one sample of all machines.

    `targets` is a lane array (axes,), `efforts` holds the same numbers as (LANES, axes). Brakes are open, and all of an IMU's channels have
    a low pass. `states` (LANES, state size) have the drives' parts in them.
    """
    n = len(side.position)
    for i in range(n):
        side.effort[i] = 0.0
    for axis in range(len(axis_joints)):
        j = axis_joints[axis]
        side.effort[j] += model.effort_gain[axis] * targets[axis]
    for step in range(models[0].steps):
        if imus > 0:
            for i in range(n):
                side.first_position[i] = side.position[i]
                side.first_speed[i] = side.speed[i]
        for lane in acting.drives:
            drive_apart(
                axis_joints, first_drive, step, limited_by, ripple_of, lane, states[lane], efforts[lane], models[lane], side, works[lane]
            )
        at_s = time_s + step * models[0].step_s
        advance_one(mass_and_bias, friction_of, reaction_of, effort_of, terms_of, at_s, acting, models, works, model, side)
        if imus > 0:
            read_imus(imu, side.first_position, side.first_speed, side.first_acceleration, model, side)
            for k in range(6 * imus):
                side.start_reading[k] = side.reading[k]
            read_imus(imu, side.position, side.speed, side.acceleration, model, side)
            for k in range(6 * imus):
                second_order(k, model, side)
    for lane in acting.drives:
        remember_targets(len(axis_joints), first_drive, states[lane], efforts[lane], models[lane])
