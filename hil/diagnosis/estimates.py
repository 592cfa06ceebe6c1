"""Values with 95 % intervals, of effects' parameters and of re-tuned numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hil.diagnosis.free_run import TRAIN, FreeRuns
from hil.diagnosis.refit import Fitted
from hil.diagnosis.result import Estimate, RetunedValue
from hil.diagnosis.retune import LARGEST_CHANGE, PRIOR, UNDECIDED, Tuning, sensitivities
from virtual_bus.effects.effect import DRIVE_UNIT
from virtual_bus.effects.places import drive_unit, is_prismatic
from virtual_bus.effects.registry import effects

TWO_SIDED_95 = 1.96


def covariance_of(runs: FreeRuns, tuning: Tuning, fitted: Fitted | None) -> np.ndarray:
    """(P + F, P + F) covariance of tuned coordinates and, where there are effects, their free parameters, widened by the repeats' own
    scatter.

    The noise model's covariance is inverse curvature of the cost. Each repeat's own small deviation of the parameters gives a second
    estimate of every variance; the larger one counts (a sandwich on its diagonal; White 1982).
    """
    offset = tuning.offset if fitted is None else fitted.offset
    columns = tuning.jacobian
    if fitted is not None:  # beside the effects: what scales a machine's every number alike scales its friction too
        columns = np.hstack([sensitivities(runs, tuning, offset, fitted.settings), fitted.jacobian])
    count = len(tuning.offset)
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-30)
    scale[:count] = 1.0
    scaled = columns / scale
    hessian = scaled.T @ scaled
    hessian[:count, :count] += np.eye(count)
    free = np.concatenate([np.abs(offset) < LARGEST_CHANGE / PRIOR, np.ones(len(hessian) - count, dtype=bool)])
    inverse = np.zeros_like(hessian)
    inverse[np.ix_(free, free)] = np.linalg.pinv(hessian[np.ix_(free, free)], rcond=1e-12, hermitian=True)
    widening = _widening(runs, scaled, inverse)
    return inverse * np.outer(widening, widening) / np.outer(scale, scale)


def _widening(runs: FreeRuns, columns: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """(P + F,) factors on standard deviations, at least 1, from how parameters fitted to each repeat scatter."""
    total = np.zeros(len(inverse))
    repeats_in_all = 0.0
    start = 0
    for group in runs.repeats(TRAIN):
        repeats = np.stack(group)
        own = columns[start : start + repeats.shape[1]]
        start += repeats.shape[1]
        if len(repeats) < 2:
            continue
        moved = (repeats - repeats.mean(axis=0)) @ own @ inverse * np.sqrt(len(repeats))
        total += (moved**2).sum(axis=0) / len(repeats)
        repeats_in_all += len(repeats) - 1.0
    if repeats_in_all == 0.0:
        return np.ones(len(inverse))
    expected = np.maximum(np.diag(inverse), 1e-300)
    prior_weight = 4.0  # repeats that the noise model counts for: few repeats alone give a poor variance
    return np.sqrt(np.maximum((prior_weight + total / expected) / (prior_weight + repeats_in_all), 1.0))


def effect_estimates(runs: FreeRuns, tuning: Tuning, fitted: Fitted, covariance: np.ndarray) -> list[Mapping[str, Estimate]]:
    """Parameters of every effect of a set."""
    spread = dict(zip(fitted.free, np.sqrt(np.maximum(np.diag(covariance)[len(tuning.offset) :], 0.0)), strict=True))
    settings = runs.machine.plant
    found: list[Mapping[str, Estimate]] = []
    for number, (effect, values) in enumerate(zip(fitted.effects, fitted.values, strict=True)):
        table = {}
        for k, (parameter, value) in enumerate(zip(effects()[effect.effect].parameters, values, strict=True)):
            reach = TWO_SIDED_95 * float(spread.get((number, k), 0.0))
            low, high = max(float(value) - reach, parameter.low), min(float(value) + reach, parameter.high)
            unit = parameter.unit_at(is_prismatic(effect.at, settings), drive_unit(effect.at, settings) or DRIVE_UNIT)
            table[parameter.name] = Estimate(float(value), unit, (low, high))
        found.append(table)
    return found


def retuned_values(tuning: Tuning, fitted: Fitted | None, covariance: np.ndarray) -> tuple[dict[str, RetunedValue], dict[str, str]]:
    """Re-tuned numbers that the recordings show, and the others with the reason why they stay."""
    offset = tuning.offset if fitted is None else fitted.offset
    count = len(offset)  # a number at its bound is held in the joint fit; effects beside it never narrow it
    spread = np.sqrt(np.maximum(np.diag(covariance)[:count], np.diag(tuning.covariance)))
    values = tuning.at(offset)
    shown, frozen = {}, {}
    tuned = {int(index): k for k, index in enumerate(tuning.indices)}
    for index, parameter in enumerate(tuning.parameters):
        name = f"{parameter.owner}.{parameter.quantity}"
        if index not in tuned:
            continue
        k = tuned[index]
        if spread[k] > UNDECIDED:
            frozen[name] = f"the recordings narrow it to {spread[k]:.0%} of what was assumed before; others do the same to them"
            continue
        value = values[index]
        reach = TWO_SIDED_95 * spread[k] * tuning.scale[k]
        shown[name] = RetunedValue(parameter.value, float(value), parameter.unit, (float(value - reach), float(value + reach)))
    return shown, frozen
