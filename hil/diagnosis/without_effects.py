"""Re-tuning once more, from where fits of effects ended.

A machine whose effect does nothing is the machine without it, so what an effect gains counts from the best numbers without it. Where
re-tuning stopped short and a fit did not, the numbers beside that fit leave less even without its effects (sealed 959, spent: 142 904 after
re-tuning, 26 990 beside a compliance of nothing).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.diagnosis.free_run import FreeRuns, Trial
from hil.diagnosis.retune import Tuning, corrected, descend, linearised
from hil.diagnosis.selection import Selection

SHORT = 5.0
"""Decrease of the cost, in units of noise, from which on re-tuning has stopped short: less than any effect needs."""


def without_effects(runs: FreeRuns, tuning: Tuning, selection: Selection) -> Tuning:
    """The tuning; where the numbers beside one of the fits leave less than it even without that fit's effects, re-tuned from there."""
    fits = [one.fitted for one in selection.contenders]
    if selection.closest is not None:
        fits.append(selection.closest)
    measured = runs.measured()
    lowest = _cost(measured, tuning.predicted, tuning.offset) - SHORT
    begun = None
    for fit, predicted in zip(fits, runs.run([Trial(tuning.at(fit.offset)) for fit in fits]), strict=True):
        if predicted is not None and _cost(measured, predicted, fit.offset) < lowest:
            lowest = _cost(measured, predicted, fit.offset)
            begun = replace(tuning, offset=fit.offset, values=tuning.at(fit.offset), predicted=predicted)
    return tuning if begun is None else corrected(runs, descend(runs, linearised(runs, begun), measured))


def _cost(measured: np.ndarray, predicted: np.ndarray, offset: np.ndarray) -> float:
    return float(np.sum((measured - predicted) ** 2) + offset @ offset)
