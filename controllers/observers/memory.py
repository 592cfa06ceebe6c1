"""The working memory of a compiled observer, and the numbers of the three filters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

KALMAN, EXTENDED, UNSCENTED = 0, 1, 2


class Memory(NamedTuple):
    """Preallocated arrays that a compiled observer changes."""

    x: np.ndarray  # (states,)
    factor: np.ndarray  # (states, states) U, P = UᵀU
    innovation: np.ndarray  # (measurements,) z - ẑ; NaN where nothing was measured
    whitened: np.ndarray  # (measurements,) innovations of unit variance, each less what those before it foretell of it; NaN likewise
    correction: np.ndarray  # (1 + measurements, states): what the last sample corrected, then its deviations, one per measurement
    corrected: np.ndarray  # (2, 9): what it corrected of the geometric parameters, and the variances of that
    bends: np.ndarray  # (states, 2 adapted): deviation of the mean of a pair of sigma points, one sample ahead
    seen: np.ndarray  # (2 states, measurements)
    array: np.ndarray  # (2 states + measurements + noise sources, measurements + states)
    lines: np.ndarray  # (6, states, signals or columns of `steps`, whichever is largest): scratch
