"""The memory a compiled plant works in: NumPy records, whose fields have sizes the compiler knows.

Both kinds are arrays of one record; its fields are attributes of `model[0]` and `work[0]`, in Python and in compiled code. To numba a
record is one pointer, where a tuple of arrays would be hundreds of words to hand over at every call.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from virtual_bus.effects.table import LIMITS, MAX_EFFORTS, MAX_FRICTIONS, MAX_PAIRS, MAX_REACTIONS, MAX_SHARED, ROW

Equations = Callable[[np.record, np.record], None]  # a generated function of `model` and `work`


def model_dtype(joints: int, axes: int, imus: int, constants: int) -> np.dtype:
    """Return the data type of everything about a plant that stays the same while it runs."""
    n = joints
    return _record(
        [
            ("step_s", "f8"),  # length of one plant step
            ("steps", "i8"),  # plant steps per sample
            ("inner_steps", "i8"),  # steps of the stiff linear part within one plant step
            ("constants", "f8", (max(constants, 1),)),  # what the equations need of the parameters, derived once
            ("stiffness", "f8", (n,)),  # per joint [Nm/rad or N/m]
            ("damping", "f8", (n,)),
            ("rest_position", "f8", (n,)),
            ("passive_stiffness", "f8", (n,)),  # the same, of joints without a drive; 0 of others
            ("brake_effort", "f8", (n,)),  # what the joint's brake holds [Nm or N]
            ("effort_gain", "f8", (max(axes, 1),)),  # joint effort per unit of drive effort
            ("filter_weights", "f8", (max(6 * imus, 1), 3)),  # low pass over one plant step: old output, input at start, input at end
            ("is_filtered", "u1", (max(6 * imus, 1),)),  # 0: the channel has no low pass and reads the instant; 2: one of second order
            ("filter_lag", "f8", (max(6 * imus, 1), 2)),  # T and D of D y'' + T y' + y = u
            ("second_weights", "f8", (max(6 * imus, 1), 2, 4)),  # after a plant step y and T y', of them and of the input at start and end
            ("friction_first", "i8", (n + 1,)),  # friction rows of joint j are friction_first[j] to friction_first[j + 1]
            ("friction_rows", "f8", (MAX_FRICTIONS, ROW)),  # effect number, then its parameters
            ("effort_count", "i8"),
            ("effort_rows", "f8", (MAX_EFFORTS, ROW)),
            ("effort_joint", "i8", (MAX_EFFORTS,)),
            ("effort_ratio", "f8", (MAX_EFFORTS,)),  # motor coordinate per joint coordinate
            ("pair_count", "i8"),
            ("pair_rows", "f8", (MAX_PAIRS, ROW)),
            ("pair_joints", "i8", (MAX_PAIRS, 2)),
            ("pair_ratio", "f8", (MAX_PAIRS,)),
            ("pair_is_spring", "u1", (MAX_PAIRS,)),  # 1: the second joint counts from its spring's rest
            ("reaction_count", "i8"),
            ("reaction_rows", "f8", (MAX_REACTIONS, ROW)),
            ("reaction_joint", "i8", (MAX_REACTIONS,)),
            ("reacts", "u1", (n,)),  # 1: an effect with a memory, or a friction that another joint shares, acts on the joint
            ("shared_count", "i8"),
            ("shared_rows", "f8", (MAX_SHARED, ROW)),
            ("shared_joints", "i8", (MAX_SHARED, 2)),
            (
                "share",
                "f8",
                (MAX_SHARED,),
            ),  # of the second joint's speed in the speed that it acts against, beside the whole of the first's
            ("has_drive_effects", "u1"),  # 0: targets are currents
            ("drive_ratio", "f8", (max(axes, 1),)),
            ("limit_rows", "f8", (max(axes, 1), LIMITS, ROW)),  # in the order in which they act; effect number -1: none
            ("ripple_rows", "f8", (max(axes, 1), ROW)),
            ("delay_samples", "f8", (max(axes, 1),)),
            ("is_lagging", "u1", (max(axes, 1),)),
            ("lag_transition", "f8", (max(axes, 1), 2, 2)),  # of (i - u, i') over a plant step
            ("lag_mean", "f8", (max(axes, 1), 2)),  # weights of its mean over the step
        ]
    )


def work_dtype(joints: int, axes: int, imus: int, bodies: int) -> np.dtype:
    """Return the data type of the scratch memory.

    It holds nothing that matters from one call to the next.
    """
    n = joints
    vectors = [
        "position", "speed", "acceleration",  # at the end of a plant step
        "friction",  # on the joints, over the last inner step
        "query_position", "query_speed", "query_acceleration",  # where the equations are evaluated
        "bias",  # gravity and velocity effort there
        "pivots", "effort", "brake", "load", "force", "derivative", "lower_derivative",
        "start_position", "start_speed", "start_acceleration",  # of an inner step
        "first_position", "first_speed", "first_acceleration",  # of a sample, under its new effort
        "friction_change", "kinetic",  # of the friction solution
    ]  # fmt: skip
    squares = ["mass", "inverse", "position_response", "speed_response"]
    readings = ["filtered", "filtered_slope", "reading", "start_reading"]
    return _record(
        [(name, "f8", (n,)) for name in vectors]
        + [(name, "f8", (n, n)) for name in squares]
        + [(name, "f8", (max(6 * imus, 1),)) for name in readings]
        + [("poses", "f8", (max(bodies, 1), 12))]
        + [("time_s", "f8"), ("query_time_s", "f8")]  # since the start; negative where a standstill is looked for
        + [(name, "f8", (max(axes, 1),)) for name in ("currents", "gains")]
        + [(name, "f8", (MAX_REACTIONS,)) for name in ("reaction", "reaction_guess")]
        + [("shared", "f8", (MAX_SHARED,))]
        + [("memory", "f8", (MAX_REACTIONS, 2))]
    )


def _record(fields: list[tuple[Any, ...]]) -> np.dtype:
    return np.dtype((np.record, np.dtype(fields, align=True)))
