"""The detector's displacement over a recording from all of its images, later ones included: for a marker plate in every exposure.

The plate's place is one set of numbers for the scan; the error of the observer's displacement fades and is renewed in seconds. The filter
runs forward through the exposures, a Rauch-Tung-Striebel smoother backward. Between two exposures the first-order process is interpolated.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from hil.calibration.data_driven.parameter_filter import DataDrivenFilter
from hil.calibration.data_driven.values import Sight


def smoothed_displacement(
    work: DataDrivenFilter,
    lasts_s: float,
    time_s: np.ndarray,
    sights: Sequence[Sight],
    covariances: Sequence[np.ndarray],
    changes: Collection[int],
    at_s: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters (p,) with all images, and the displacement's error (N, 6) at times `at_s` (N,).

    Parameters
    ----------
    work : DataDrivenFilter
        Fresh; is run to the last image.
    lasts_s : float
        The displacement's error fades with this.
    time_s : (M,) array
        Of the exposures, rising.
    sights : sequence of M
        What each says.
    covariances : sequence of M (k, k) arrays
    changes : collection of int
        Exposures before which the mount was moved.
    """
    size, count = work.size, work.size + 6
    scale = np.sqrt(np.diag(work.covariance))
    scale = np.where(scale > 0.0, scale, 1.0)
    filtered, predicted = [], []
    now = float(time_s[0])
    for k, (at, sight, covariance) in enumerate(zip(time_s, sights, covariances, strict=True)):
        work.predict(float(at) - now)
        now = float(at)
        if k in changes:
            work.forget_mount()
        predicted.append((work.x.copy(), work.covariance.copy()))
        work.exposed(k)
        innovation, gradient = work.innovation(k, *sight)
        work.update(innovation, gradient, covariance)
        work.dropped(k)
        filtered.append((work.x.copy(), work.covariance.copy()))
    x = filtered[-1][0]
    strays = np.zeros((len(time_s), 6))
    strays[-1] = x[size:]
    for k in range(len(time_s) - 2, -1, -1):
        moved = np.ones(count)
        moved[size:] = np.exp(-(time_s[k + 1] - time_s[k]) / lasts_s)
        ahead = predicted[k + 1][1] / np.outer(scale, scale)
        change = np.linalg.lstsq(ahead, (x - predicted[k + 1][0]) / scale, rcond=1e-14)[0] / scale
        x = filtered[k][0] + filtered[k][1] @ (moved * change)
        strays[k] = x[size:]
    return filtered[-1][0][:size], _bridged(time_s, strays, at_s, lasts_s)


def _bridged(time_s: np.ndarray, strays: np.ndarray, at_s: np.ndarray, lasts_s: float) -> np.ndarray:
    """Return the mean of a first-order process between instants at which it is known; beyond them it fades."""
    after = np.searchsorted(time_s, at_s)
    left, right = np.maximum(after - 1, 0), np.minimum(after, len(time_s) - 1)
    since, until = np.abs(at_s - time_s[left]) / lasts_s, np.abs(time_s[right] - at_s) / lasts_s
    # sinh(until) / sinh(since + until) and the other way round, written so that a pause of any length does not overflow
    whole = np.where(left == right, 1.0, -np.expm1(-2.0 * (since + until)))
    of_left = np.exp(-since) * np.where(left == right, 1.0, -np.expm1(-2.0 * until) / whole)
    of_right = np.where(left == right, 0.0, -np.exp(-until) * np.expm1(-2.0 * since) / whole)
    blended: np.ndarray = of_left[:, None] * strays[left] + of_right[:, None] * strays[right]
    return blended
