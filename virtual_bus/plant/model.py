"""The arrays the compiled plant works on, as named tuples that numba takes as they are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Model(NamedTuple):
    """Everything about a plant that stays the same while it runs. Made by `CompiledPlant.model`; all arrays float64 unless said."""

    step_s: float  # length of one plant step
    steps: int  # plant steps per sample
    inner_steps: int  # steps of the stiff linear part within one plant step
    constants: np.ndarray  # what the equations need of the parameters, derived once
    stiffness: np.ndarray  # (n,) per joint
    damping: np.ndarray  # (n,)
    rest_position: np.ndarray  # (n,)
    brake_effort: np.ndarray  # (n,)
    effort_gain: np.ndarray  # (axes,) joint effort per unit of drive effort
    filter_weights: np.ndarray  # (6 imus, 3) of each IMU channel's low pass over a plant step: old output, input at start, input at end
    is_filtered: np.ndarray  # (6 imus,) bool; False: the channel has no low pass and reads the instant
    friction_first: np.ndarray  # (n + 1,) int64: friction rows of joint j are friction_first[j] to friction_first[j + 1]
    friction_rows: np.ndarray  # (rows, 1 + parameters): effect number, then its parameters


class Work(NamedTuple):
    """Scratch memory of the compiled plant, so that nothing is allocated while it runs. Holds no state from one sample to the next."""

    position: np.ndarray  # (n,) where the slow part of the equations is evaluated
    speed: np.ndarray  # (n,)
    mass: np.ndarray  # (n, n) joint-space inertia, then its factors
    bias: np.ndarray  # (n,) gravity and velocity effort
    inverse: np.ndarray  # (n, n) of the joint-space inertia
    pivots: np.ndarray  # (n,)
    effort: np.ndarray  # (n,) of the drives, on the joints
    brake: np.ndarray  # (n,) what the joint's closed brake holds
    load: np.ndarray  # (n,) effort of the drives less bias
    force: np.ndarray  # (n,)
    derivative: np.ndarray  # (n,)
    lower_derivative: np.ndarray  # (n,)
    start_acceleration: np.ndarray  # (n,) at the start of an inner step
    start_speed: np.ndarray  # (n,)
    first_position: np.ndarray  # (n,) at the start of a sample, under its new effort
    first_speed: np.ndarray  # (n,)
    first_acceleration: np.ndarray  # (n,)
    friction_change: np.ndarray  # (n,)
    position_response: np.ndarray  # (n, n) row j: change of all positions per unit of friction at joint j
    speed_response: np.ndarray  # (n, n) row j: the same of all speeds
    reading: np.ndarray  # (6 imus,) of the IMUs, before their low passes
    end_reading: np.ndarray  # (6 imus,)


def new_work(joints: int, imus: int) -> Work:
    """Scratch memory for a plant of that many joints and IMUs."""
    shapes = {"mass": (joints, joints), "inverse": (joints, joints), "reading": (6 * imus,), "end_reading": (6 * imus,)}
    shapes |= {"position_response": (joints, joints), "speed_response": (joints, joints)}
    return Work(*(np.zeros(shapes.get(field, (joints,))) for field in Work._fields))
