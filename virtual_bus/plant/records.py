"""The memory a compiled plant works in: NumPy records, whose fields have sizes the compiler knows.

Both kinds are arrays of one record; its fields are attributes of `model[0]` and `work[0]`, in Python and in compiled code. A record is one
pointer to numba, where a tuple of arrays would be hundreds of words to hand over at every call.
"""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.effect import MAX_PARAMETERS
from virtual_bus.effects.table import MAX_ROWS


def model_dtype(joints: int, axes: int, imus: int, constants: int) -> np.dtype:
    """Everything about a plant that stays the same while it runs."""
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
            ("brake_effort", "f8", (n,)),  # what the joint's brake holds [Nm or N]
            ("effort_gain", "f8", (max(axes, 1),)),  # joint effort per unit of drive effort
            ("filter_weights", "f8", (max(6 * imus, 1), 3)),  # low pass over one plant step: old output, input at start, input at end
            ("is_filtered", "u1", (max(6 * imus, 1),)),  # 0: the channel has no low pass and reads the instant
            ("friction_first", "i8", (n + 1,)),  # friction rows of joint j are friction_first[j] to friction_first[j + 1]
            ("friction_rows", "f8", (MAX_ROWS, 1 + MAX_PARAMETERS)),  # effect number, then its parameters
        ]
    )


def work_dtype(joints: int, imus: int, bodies: int) -> np.dtype:
    """Scratch memory. It holds nothing that matters from one call to the next."""
    n = joints
    vectors = [
        "position", "speed", "acceleration",  # at the end of a plant step
        "friction",  # on the joints, over the last inner step
        "query_position", "query_speed", "query_acceleration",  # where the equations are evaluated
        "bias",  # gravity and velocity effort there
        "pivots", "effort", "brake", "load", "force", "derivative", "lower_derivative",
        "start_speed", "start_acceleration",  # of an inner step
        "first_position", "first_speed", "first_acceleration",  # of a sample, under its new effort
        "friction_change", "kinetic",  # of the friction solution
    ]  # fmt: skip
    squares = ["mass", "inverse", "position_response", "speed_response"]
    readings = ["filtered", "reading", "start_reading"]
    return _record(
        [(name, "f8", (n,)) for name in vectors]
        + [(name, "f8", (n, n)) for name in squares]
        + [(name, "f8", (max(6 * imus, 1),)) for name in readings]
        + [("poses", "f8", (max(bodies, 1), 12))]
    )


def _record(fields: list[tuple]) -> np.dtype:
    return np.dtype((np.record, np.dtype(fields, align=True)))
