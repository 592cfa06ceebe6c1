"""What the hooks of effects are told, and the functions that call a hook by its effect's number.

A hook gets the state of the place it acts at. The functions are compiled by `dispatch.py`: `function(number, state, row)`, where `row` is
the effect's number and then its parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class JointState(NamedTuple):
    """What a friction law may depend on, at the joint."""

    speed: float  # magnitude [rad/s or m/s]
    direction: float  # +1 or -1: of the motion, or of the motion that is about to begin
    position: float  # [rad or m]
    load: float  # effort that gravity, velocities and added efforts ask of the joint [Nm or N]
    motor: float = 0.0  # effort on the joint of its drive, or where it has none of its spring, less the joint's damper [Nm or N]


class JointMotion(NamedTuple):
    """What an effort on a joint may depend on."""

    position: float  # [rad or m]
    speed: float
    time_s: float  # since the start; negative where a standstill is looked for
    ratio: float  # motor coordinate per joint coordinate; 1 on a joint without drive
    stiffness: float  # of the joint's spring [Nm/rad or N/m]
    deflection: float  # position less the spring's rest position


class PairMotion(NamedTuple):
    """What a term between two joints may depend on."""

    position: float  # of the first joint, the axis's own
    speed: float
    other_position: float  # of the second; its deflection where it is a spring
    other_speed: float
    ratio: float  # of the axis
    stiffness: float  # of the second joint's spring


class ReactionState(NamedTuple):
    """An effect with memory over one step: its two states at the step's start, and the joint's motion over it."""

    first: float
    second: float
    position: float  # of the joint at the start
    start_speed: float
    end_speed: float
    step_s: float


class DriveState(NamedTuple):
    """What a drive may depend on."""

    current: float  # [drive's unit]
    speed: float  # of the joint
    position: float  # of the joint
    ratio: float


class ReactionSlopes(NamedTuple):
    """An effect with a memory m of any length k, for small motions about rest: its hook `slopes(*parameters)`.

    The memory changes by memory m + motion (position, speed, acceleration), the effort on the joint is effort_of_memory m +
    effort_of_motion (position, speed).
    """

    memory: np.ndarray  # (k, k)
    motion: np.ndarray  # (k, 3)
    effort_of_memory: np.ndarray  # (k,)
    effort_of_motion: tuple[float, float]


FrictionOf = Callable[[int, JointState, np.ndarray], float]
EffortOf = Callable[[int, JointMotion, np.ndarray], float]
TermsOf = Callable[[int, PairMotion, np.ndarray], tuple[float, float, float, float]]
ReactionOf = Callable[[int, ReactionState, np.ndarray], tuple[float, float, float]]
LimitedBy = Callable[[int, DriveState, np.ndarray], float]
RippleOf = Callable[[int, DriveState, np.ndarray], float]
EncoderErrorOf = Callable[[int, float, np.ndarray], float]  # of a position
SignedBy = Callable[[int, float, np.ndarray], float]  # of a channel's value
LagOf = Callable[[int, float, np.ndarray], float]  # of the time [s]
LostBy = Callable[[int, int, np.ndarray], bool]  # of the sample's number
