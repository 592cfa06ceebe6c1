"""Noise where nothing repeats: disturbances as strong as makes what the engineer's first fit leaves of the size that they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.diagnosis.candidates.columns import column
from hil.diagnosis.named.fitting import Fitted
from hil.diagnosis.seen.assumed import with_rows
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.tuned.retuning import Tuned

WIDEST, HALVINGS = 1000.0, 10
"""Factor that the disturbances' first level may be off by, and halvings of its logarithm: to a per cent."""


def matched(levels: Levels, tuned: Tuned, fitted: Fitted) -> Levels:
    """Return the levels with disturbances as strong as makes what a fit leaves of the mean size that they say."""
    parts = []
    for one in tuned.looked:
        along = one.beside.along
        with_it = along.signals(one.motion, along.model(tuned.values, fitted.settings), fitted.settings)
        extra = column(one.signals, with_it)
        parts.append(one.beside.less(extra.efforts, extra.readings))
    low, high = -np.log(WIDEST), np.log(WIDEST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        scaled = with_rows(parts[0].along, replace(levels, disturbance=levels.disturbance * np.exp(middle)))
        squares = sum(float(np.sum(part.whitened(part.whitening(scaled)) ** 2)) for part in parts)
        low, high = (middle, high) if squares > tuned.readings else (low, middle)
    return with_rows(parts[0].along, replace(levels, disturbance=levels.disturbance * np.exp(0.5 * (low + high))))
