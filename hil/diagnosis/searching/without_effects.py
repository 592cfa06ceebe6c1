"""Re-tuning once more, from where fits of effects ended.

A machine whose effect does nothing is the machine without it, so what an effect gains counts from the best numbers without it. Where
re-tuning stopped short and a fit did not, the numbers beside that fit leave less even without its effects: 26 990 in units of noise, say,
instead of 142 904. An effect that is a number of the machine file, and no further off than re-tuning may go, is such a number and not what
the file leaves out: it counts as one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.searching.selection import Selection
from hil.diagnosis.tuning.free_run import FreeRuns, Trial
from hil.diagnosis.tuning.retune import LARGEST_CHANGE, PRIOR, Tuning, corrected, descend, linearised
from virtual_bus.effects.table import changed_values
from virtual_bus.settings import PlantSettings

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
    offsets = [fit.offset for fit in fits]
    offsets += [offset for offset in (with_its_numbers(tuning, fit, runs.machine.plant) for fit in fits) if offset is not None]
    for offset, predicted in zip(offsets, runs.run([Trial(tuning.at(offset)) for offset in offsets]), strict=True):
        if predicted is not None and _cost(measured, predicted, offset) < lowest:
            lowest = _cost(measured, predicted, offset)
            begun = replace(tuning, offset=offset, values=tuning.at(offset), predicted=predicted)
    return tuning if begun is None else corrected(runs, descend(runs, linearised(runs, begun), measured))


def with_its_numbers(tuning: Tuning, fit: Fitted, settings: PlantSettings) -> np.ndarray | None:
    """(P,) tuned coordinates with what a fit's effects make of the machine's own numbers; None where they change none of these, one that is
    not tuned, or one by more than re-tuning may.
    """
    names = [(parameter.owner, parameter.quantity) for parameter in tuning.parameters]
    beside = dict(zip(names, tuning.at(fit.offset).tolist(), strict=True)) | {(imu.name, "low_pass_shape"): 0.0 for imu in settings.imus}
    values = dict(beside)
    changed_values(values, fit.settings, settings)
    changed = {name for name, value in values.items() if value != beside[name]}
    tuned, bound = [names[index] for index in tuning.indices], LARGEST_CHANGE / PRIOR
    offset = fit.offset + np.array([values[name] - beside[name] for name in tuned]) / tuning.scale
    own = np.array([name in changed for name in tuned])
    is_tuning = changed and changed <= set(tuned) and float(np.abs(offset[own]).max()) <= bound
    return np.clip(offset, -bound, bound) if is_tuning else None  # a fit's steps may end a little beyond


def _cost(measured: np.ndarray, predicted: np.ndarray, offset: np.ndarray) -> float:
    return float(np.sum((measured - predicted) ** 2) + offset @ offset)
