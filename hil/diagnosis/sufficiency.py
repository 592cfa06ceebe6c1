"""Do these recordings hold enough to say anything? If not, what is missing."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.mismatch import Mismatch
from hil.diagnosis.noise import FILTER_ORDER
from hil.diagnosis.selection import Selection

LEAST_DURATION_s = 1.0
LEAST_ROWS = 8 * FILTER_ORDER
LEAST_SIGNAL = 3.0
"""Motion in units of the channels' noise below which nothing moved."""


def what_is_missing(train: Mismatch, selection: Selection) -> str:
    """One sentence; "" where the recordings suffice."""
    longest = max((group for group in train.groups), key=lambda group: len(group.time_s))
    duration = float(longest.time_s[-1] - longest.time_s[0])
    if duration < LEAST_DURATION_s or len(longest.time_s) < LEAST_ROWS:
        return f"the longest recording lasts {duration:.3g} s; {LEAST_DURATION_s:g} s or more are needed"
    moves = np.array([np.std(group.mean, axis=0) for group in train.groups]).max(axis=0) / train.noise.std
    if not any(gate.passed for gate in selection.gates) and moves.max() < LEAST_SIGNAL:
        return f"nothing moves: the liveliest channel varies by {moves.max():.2g} times its noise; record a motion or an excitation"
    return ""
