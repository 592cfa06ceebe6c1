"""A machine's trend: level and slope of all its parameters with their covariance, as it is and drawn towards the fleet's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.fleet.change.night_by_night import FleetChange
from hil.fleet.change.scatter_model import FEWEST, deviation

FARTHEST = 2.5
"""Deviations from which on a night counts less (Huber), as in the bank."""

ROUNDS = 10
"""Of reweighting: the weights of bad nights settle in four or five."""


@dataclass(frozen=True, eq=False)
class Trend:
    """Straight lines through a machine's results, what is common to the fleet taken off; P parameters.

    Parameters
    ----------
    level, slope : (P,) arrays
        Value in the middle of the nights, and change a night, in each parameter's unit; NaN where there are no results.
    covariance : (2 P, 2 P) array
        Of levels and then slopes.
    shrunk_slope : (P,) array
        The slope drawn towards the fleet's: its expectation, given how much machines differ.
    middle : float
        Nights from the first one to the middle.
    """

    level: np.ndarray
    slope: np.ndarray
    covariance: np.ndarray
    shrunk_slope: np.ndarray
    middle: float


def trend_of(found: FleetChange, machine: str) -> Trend:
    """Return the trend of a machine, by generalised least squares in all parameters at once.

    Scatter that is carried from night to night enters as it acts on means over many nights, times (1 + memory) / (1 - memory).
    """
    assert found.model is not None
    index = list(found.tracks.machines).index(machine)
    level, slope, covariance, middle = _lines(found, index)
    count = len(slope)
    shrunk = slope.copy()
    if len(found.tracks.machines) >= FEWEST:
        slopes, variances = _all_slopes(found)
        for j in np.flatnonzero(np.isfinite(slope)):
            between = max(deviation(slopes[:, j]) ** 2 - np.nanmedian(variances[:, j]), 0.0)
            own = covariance[count + j, count + j]
            shrunk[j] = slope[j] * between / (between + own) if between + own > 0.0 else slope[j]
    return Trend(level, slope, covariance, shrunk, middle)


def _lines(found: FleetChange, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    tracks, model = found.tracks, found.model
    assert model is not None
    own = tracks.values[index] - found.common
    days = (tracks.nights - tracks.nights[0]).astype(float)
    middle = float(days.mean())
    extra = np.diag(model.scale**2 * (model.white + model.carried * (1.0 + model.memory) / (1.0 - model.memory)))
    count = own.shape[1]
    used = np.isfinite(own).sum(axis=0) >= 3
    weights = np.ones(own.shape)
    level, slope = np.full(count, np.nan), np.full(count, np.nan)
    covariance = np.full((2 * count, 2 * count), np.nan)
    if not used.any():
        return level, slope, covariance, middle
    place = np.concatenate([np.flatnonzero(used), count + np.flatnonzero(used)])
    solution = np.zeros(len(place))
    for _ in range(ROUNDS):
        information, target = np.zeros((len(place), len(place))), np.zeros(len(place))
        for night, day in enumerate(days):
            here = np.flatnonzero(np.isfinite(own[night, used]))
            if not len(here):
                continue
            named = np.flatnonzero(used)[here]
            root = np.sqrt(weights[night, named])
            inverse = np.linalg.pinv((tracks.covariances[index, night] + extra)[np.ix_(named, named)]) * np.outer(root, root)
            both = np.concatenate([here, used.sum() + here])
            line = np.array([1.0, day - middle])
            information[np.ix_(both, both)] += np.kron(np.outer(line, line), inverse)
            target[both] += np.kron(line, inverse @ own[night, named])
        solution = np.linalg.pinv(information, hermitian=True) @ target
        fitted = solution[: used.sum()] + np.outer(days - middle, solution[used.sum() :])
        spread = np.sqrt(np.diagonal(tracks.covariances[index], axis1=1, axis2=2) + np.diag(extra))[:, used]
        far = np.abs(own[:, used] - fitted) / np.maximum(spread, 1e-300)
        weights[:, used] = FARTHEST / np.maximum(np.nan_to_num(far), FARTHEST)
    level[used], slope[used] = solution[: used.sum()], solution[used.sum() :]
    covariance[np.ix_(place, place)] = np.linalg.pinv(information, hermitian=True)
    return level, slope, covariance, middle


def _all_slopes(found: FleetChange) -> tuple[np.ndarray, np.ndarray]:
    """Return every machine's slopes parameter by parameter, and their variances: enough to see how much machines differ."""
    tracks, model = found.tracks, found.model
    assert model is not None
    days = (tracks.nights - tracks.nights[0]).astype(float)[None, :, None]
    own = tracks.values - found.common
    known = np.isfinite(own)
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)
    x = np.where(known, days - (known * days).sum(axis=1, keepdims=True) / count, 0.0)
    square = np.maximum((x**2).sum(axis=1), 1e-12)
    slopes = (x * np.nan_to_num(own)).sum(axis=1) / square
    slopes[known.sum(axis=1) < 3] = np.nan
    return slopes, model.scale**2 / square
