"""The course of a change that is certain: a step or a growth, and since when, from the nights themselves and not from cut evidence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.fleet.change.bank import CUT
from hil.fleet.change.scatter_model import deviation

INTERVAL = 3.84
"""By which twice the log likelihood falls at the ends of a 95 % interval (chi square, one degree of freedom)."""


class Course(NamedTuple):
    """A change's kind, and the places in the nights on which it began: likeliest, and the ends of a 95 % interval."""

    kind: str
    since: int
    since_from: int
    since_to: int


def course_of(days: np.ndarray, values: np.ndarray) -> Course:
    """Return the course that leaves least of a machine's values, each night counting `CUT` deviations at most.

    Parameters
    ----------
    days, values : (N,) arrays
        Nights with results, rising, and the results, what is common taken off; N at least 3.
    """
    left = {kind: np.array([_left(kind, days, values, begin) for begin in range(1, len(days))]) for kind in ("step", "growth")}
    rough = deviation(np.diff(values)) / np.sqrt(2.0)  # a change shows in one difference of many
    scale = rough if rough > 0.0 else 1.0
    costs = {kind: np.minimum((residuals / scale) ** 2, CUT**2).sum(axis=1) for kind, residuals in left.items()}
    kind = min(costs, key=lambda each: float(costs[each].min()))
    cost = costs[kind]
    likely = np.flatnonzero(cost <= cost.min() + INTERVAL) + 1
    return Course(kind, int(cost.argmin()) + 1, int(likely[0]), int(likely[-1]))


def _left(kind: str, days: np.ndarray, values: np.ndarray, begin: int) -> np.ndarray:
    """Return what a change that begins at a place leaves, fitted by medians."""
    before, after = np.median(values[:begin]), values[begin:]
    if kind == "step":
        return np.concatenate([values[:begin] - before, after - np.median(after)])
    grown = days[begin:] - days[begin] + 1.0
    slope = _weighted_median((after - before) / grown, grown)
    return np.concatenate([values[:begin] - before, after - before - slope * grown])


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(share, 0.5 * share[-1])])
