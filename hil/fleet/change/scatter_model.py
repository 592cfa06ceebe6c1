"""How results of a fleet scatter when nothing changes: from the fleet's own nights, by medians, so that few changed machines do not count.

A night's result of a machine is its level, plus what is common to the fleet, plus scatter that it carries from night to night, plus noise.
Notation: y the results in units of their nightly scatter; u the same, each less what the other parameters' scatter predicts of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.fleet.change.tracks import Tracks

FEWEST = 8
"""Machines with results from which on the median of a night tells what is common: below, one changed machine would move it by more than
a tenth of the scatter (the median of 7 and 1 that is far away lies 0.18 deviations aside, and less with every further one)."""

MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, in standard deviations
MEDIAN_VARIANCE = np.pi / 2.0  # of the median of n normal numbers, in units of variance / n
LAGS = 8
"""Nights over which scatter is compared: more would mix in seasons and slow growth."""

MEMORIES = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9)
"""Correlations from night to night that are tried for the scatter that is carried; longer memory is a trend."""

LEAST_EIGENVALUE = 0.02
"""Of the correlation between parameters: an estimate from few nights may be singular, and then predictions of one by another are wild."""

FARTHEST = 3.0
"""Deviations from which on a night counts as bad."""


@dataclass(frozen=True, eq=False)
class FleetModel:
    """Scatter of a fleet's results, learned from its nights; P parameters.

    Parameters
    ----------
    scale : (P,) array
        Standard deviation of y, in each parameter's unit.
    adjustment : (P, P) array
        u = adjustment @ y: each parameter less its regression on all others (Hawkins 1991, Technometrics 33(1), eq. (3)).
    correlation : (P, P) array
        Between the u.
    white, carried, memory : (P,) arrays
        Of u: variance of noise beyond the measured covariance, variance of scatter that is carried, and its correlation between nights.
    level, spread : (P,) arrays
        Of u: median and standard deviation over the machines.
    bad_nights : float
        Share of results farther out than noise explains.
    """

    scale: np.ndarray
    adjustment: np.ndarray
    correlation: np.ndarray
    white: np.ndarray
    carried: np.ndarray
    memory: np.ndarray
    level: np.ndarray
    spread: np.ndarray
    bad_nights: float


def deviation(values: np.ndarray, axis: int | tuple[int, int] | None = None) -> np.ndarray:
    """Return the standard deviation about 0 by the median of absolute values, NaN left out."""
    return np.asarray(np.nanmedian(np.abs(values), axis=axis) / MEDIAN_OF_NORMAL)


def fit_model(tracks: Tracks) -> FleetModel:
    """Learn how results scatter."""
    values = tracks.values
    steps = _differences(values, 1)
    scale = deviation(steps, axis=(0, 1)) / np.sqrt(2.0)
    usual = np.sqrt(np.median(np.diagonal(tracks.covariances, axis1=2, axis2=3), axis=(0, 1)))
    scale = np.where(np.isfinite(scale) & (scale > 0.0), scale, np.where(usual > 0.0, usual, 1.0))
    precision = np.linalg.inv(_correlation(steps / (scale * np.sqrt(2.0))))
    diagonal = np.diag(precision)
    adjustment = precision / diagonal[:, None]
    u, measured = adjusted(tracks, scale, adjustment)
    white, carried, memory, bad = _scatter(u, measured)
    level = np.nanmedian(u, axis=1)
    centre = np.nanmedian(level, axis=0)
    return FleetModel(
        scale, adjustment, precision / np.sqrt(np.outer(diagonal, diagonal)), white, carried, memory,
        centre, np.maximum(deviation(level - centre, axis=0), np.sqrt(white + carried)), bad,
    )  # fmt: skip


def adjusted(tracks: Tracks, scale: np.ndarray, adjustment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return u (M, T, P), and the variance of each by the measured covariances.

    Where another parameter is missing, its last value stands in, with the variance of a night more.
    """
    filled = _last_known(tracks.values) / scale
    u = filled @ adjustment.T
    u[~np.isfinite(tracks.values)] = np.nan
    measured = np.einsum("jk,mtkl,jl->mtj", adjustment / scale, tracks.covariances, adjustment / scale, optimize=True)
    missing = (~np.isfinite(tracks.values)).astype(float)
    return u, measured + missing @ (adjustment**2).T


def _last_known(values: np.ndarray) -> np.ndarray:
    """Return the values with each gap filled from the night before; before the first, from the first."""
    known = np.isfinite(values)
    place = np.arange(values.shape[1])[None, :, None]
    last = np.maximum.accumulate(np.where(known, place, -1), axis=1)
    first = np.argmax(known, axis=1)[:, None, :]
    filled = np.take_along_axis(values, np.where(last >= 0, last, first), axis=1)
    return np.where(np.isfinite(filled), filled, np.nanmedian(values, axis=(0, 1)))


def _differences(values: np.ndarray, lag: int) -> np.ndarray:
    """Return differences over so many nights, less the fleet's median of each."""
    steps = values[:, lag:] - values[:, :-lag]
    return np.asarray(steps - np.nanmedian(steps, axis=0) if len(values) >= FEWEST else steps)


def _correlation(steps: np.ndarray) -> np.ndarray:
    """Return the correlation of scaled differences (M, T, P), by deviations of sums and differences (Gnanadesikan, Kettenring 1972)."""
    flat = steps.reshape(-1, steps.shape[2])
    count = flat.shape[1]
    found = np.eye(count)
    for j in range(count):
        for k in range(j):
            both = flat[np.isfinite(flat[:, j] + flat[:, k])]
            if len(both) > count:
                plus, minus = deviation(both[:, j] + both[:, k]) ** 2, deviation(both[:, j] - both[:, k]) ** 2
                found[j, k] = found[k, j] = (plus - minus) / (plus + minus) if plus + minus > 0.0 else 0.0
    values, vectors = np.linalg.eigh(found)
    found = vectors * np.maximum(values, LEAST_EIGENVALUE) @ vectors.T
    size = np.sqrt(np.diag(found))
    return np.asarray(found / np.outer(size, size))


def _scatter(u: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Split the variogram of u into noise and carried scatter, each at its upper bound.

    Half the mean square difference over k nights is white + carried (1 - memory^k). The bound is two standard errors of the deviation,
    1.17 / sqrt(n) for n independent numbers (Rousseeuw, Croux 1993, JASA 88, Sec. 1), with neighbouring differences counted as 2/3.
    """
    lags = np.arange(1, min(LAGS, u.shape[1] // 2) + 1)
    variogram = np.array([deviation(_differences(u, lag), axis=(0, 1)) ** 2 / 2.0 for lag in lags])
    count = np.isfinite(_differences(u, 1)).sum(axis=(0, 1))
    bound = (1.0 + 2.0 * 1.17 / np.sqrt(np.maximum(count * 2.0 / 3.0, 1.0))) ** 2
    best = np.full(u.shape[2], np.inf)
    white, carried, memory = np.nan_to_num(variogram[0]), np.zeros(u.shape[2]), np.zeros(u.shape[2])
    for phi in MEMORIES:
        columns = np.column_stack([np.ones(len(lags)), 1.0 - phi**lags]) if phi else np.ones((len(lags), 1))
        for j in range(u.shape[2]):
            fitted, error = _non_negative(columns, variogram[:, j])
            if error < best[j]:
                best[j], white[j], carried[j], memory[j] = error, fitted[0], fitted[1] if phi else 0.0, phi
    far = np.abs(_differences(u, 1)) > FARTHEST * np.sqrt(2.0 * variogram[0])
    bad = max(0.0, (float(far[np.isfinite(_differences(u, 1))].mean()) - 0.0027) / 2.0)  # each bad night shows in two differences
    typical = np.nan_to_num(np.nanmedian(np.where(np.isfinite(u), measured, np.nan), axis=(0, 1)))
    return np.maximum(white * bound - typical, 0.0), carried * bound, memory, bad


def _non_negative(columns: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, float]:
    from scipy.optimize import nnls

    if not np.isfinite(target).all():
        return np.zeros(columns.shape[1]), np.inf
    solution, error = nnls(columns, target)
    return solution, float(error)
