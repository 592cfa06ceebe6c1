"""Noise where nothing repeats: disturbances as strong as makes what the engineer's first fit leaves of the size that they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.diagnosis.candidates.columns import column
from hil.diagnosis.model_choice.fitting import Fitted
from hil.diagnosis.residuals.assumed_noise import with_rows
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.retuning.linear_model import LinearModel

WIDEST, HALVINGS = 1000.0, 10
"""Factor that the disturbances' first level may be off by, and halvings of its logarithm: to a per cent."""


def matched(levels: Levels, linear: LinearModel, fitted: Fitted) -> Levels:
    """Return the levels with disturbances as strong as makes what a fit leaves of the mean size that they say."""
    parts = []
    for one in linear.records:
        trajectory = one.equations.trajectory
        with_it = trajectory.signals(one.motion, trajectory.model(linear.values, fitted.settings), fitted.settings)
        extra = column(one.signals, with_it)
        parts.append(one.equations.less(extra.efforts, extra.readings))
    low, high = -np.log(WIDEST), np.log(WIDEST)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        scaled = with_rows(parts[0].trajectory, replace(levels, disturbance=levels.disturbance * np.exp(middle)))
        squares = sum(float(np.sum(part.whitened(part.whitening(scaled)) ** 2)) for part in parts)
        low, high = (middle, high) if squares > linear.readings else (low, middle)
    return with_rows(parts[0].trajectory, replace(levels, disturbance=levels.disturbance * np.exp(0.5 * (low + high))))
