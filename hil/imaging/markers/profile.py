"""A line to a small fraction of a pixel: one model of its profile, fitted to every pixel near it at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from hil.imaging.markers.lines import CoarseLine

SIZE = 12
"""Parameters: offset, slope, width, blur; background (three along; across, across times along); contrast (three along)."""

STEPS = 6
OUTLIER = 6.0
"""A pixel this many standard deviations from its filtered neighbourhood is dead."""

SETTLED_PIXELS = 2e-3
"""Steps shrink at least tenfold; what is left is below the photons' noise."""


@dataclass(frozen=True)
class FineLine:
    """across = offset + slope * (along - middle) [pixel].

    Attributes
    ----------
    offset, slope, middle : float
    covariance : (2, 2) array
        Of offset and slope; scaled by `misfit` where that is above 1.
    width, blur, contrast : float
        Of the profile [pixel, pixel, image's unit].
    misfit : float
        Sum of squares over degrees of freedom, in units of the photons' noise where the image holds counts.
    half_length : float
    """

    offset: float
    slope: float
    middle: float
    covariance: np.ndarray
    width: float
    blur: float
    contrast: float
    misfit: float
    half_length: float


def fit_profile(
    image: np.ndarray, filtered: np.ndarray, line: CoarseLine, width: float, blur: float, keep: np.ndarray, upright: bool
) -> FineLine | None:
    """Fit a bright line: a box blurred by a Gaussian, on a background that varies slowly.

    Parameters
    ----------
    image, filtered : (rows, columns) float32 arrays
        Raw, and with noise filtered: that gives each pixel's variance and shows dead ones.
    line : CoarseLine
    width, blur : float
        Expected [pixel].
    keep : bool array
        Places along the line to use.
    upright : bool
        The line runs along the rows' growing index.

    Returns
    -------
    FineLine or None
        None: too few pixels, or nothing there that looks like the line.
    """
    places = np.flatnonzero(keep)
    if len(places) < 30:
        return None
    middle, half = 0.5 * (places[0] + places[-1]), 0.5 * (places[-1] - places[0])
    values = np.zeros(SIZE)
    values[:4] = line.at(middle), line.slope * half, width, blur
    reach = 0.5 * width + 4.0 * blur + 1.0
    try:
        covariance, misfit, count = _fit(image, filtered, upright, places, middle, half, reach, values, width)
    except np.linalg.LinAlgError:
        return None  # the pixels do not determine the profile: no groove's contrast is left in them
    if count < 20 * SIZE or not np.isfinite(values).all() or values[9] <= 0.0:
        return None
    scale = np.array([1.0, 1.0 / half])
    return FineLine(
        float(values[0]),
        float(values[1] / half),
        middle,
        covariance[:2, :2] * np.outer(scale, scale) * max(misfit, 1.0),
        float(values[2]),
        float(abs(values[3])),
        float(values[9]),
        float(misfit),
        half,
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def _fit(
    image: np.ndarray,
    filtered: np.ndarray,
    upright: bool,
    places: np.ndarray,
    middle: float,
    half: float,
    reach: float,
    values: np.ndarray,
    width: float,
) -> tuple[np.ndarray, float, int]:
    # told which way the line runs, since transposed arrays would be compiled once more; loops in place of sums of arrays compile faster
    across_size = image.shape[1] if upright else image.shape[0]
    covariance = np.zeros((SIZE, SIZE))
    misfit, count = 0.0, 0
    slope_row = np.empty(SIZE)
    start, tilt = values[0], values[1]  # the window stays in place: the fit must not choose its own data
    for step in range(STEPS):
        normal, slope = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
        total, count = 0.0, 0
        first = 4 if step == 0 else 0  # background and contrast alone, linearly
        root = 1.0 / (math.sqrt(2.0) * values[3])
        peak = 1.0 / (math.sqrt(2.0 * math.pi) * values[3])
        for along in places:
            s = (along - middle) / half
            center = values[0] + values[1] * s
            window = start + tilt * s
            background = values[4] + values[5] * s + values[6] * s * s
            across_slope = values[7] + values[8] * s
            contrast = values[9] + values[10] * s + values[11] * s * s
            for across in range(max(0, math.ceil(window - reach)), min(across_size - 1, math.floor(window + reach)) + 1):
                row, column = (along, across) if upright else (across, along)
                expected = max(filtered[row, column], 1.0)
                seen = image[row, column]
                if (seen - expected) ** 2 > OUTLIER**2 * expected:
                    continue
                d = across - center
                left, right = d + 0.5 * values[2], d - 0.5 * values[2]
                shape = 0.5 * (math.erf(left * root) - math.erf(right * root))
                gauss_left, gauss_right = peak * math.exp(-((left * root) ** 2)), peak * math.exp(-((right * root) ** 2))
                rest = seen - (background + across_slope * d + contrast * shape)
                slope_row[0] = -contrast * (gauss_left - gauss_right) - across_slope
                slope_row[1] = slope_row[0] * s
                slope_row[2] = 0.5 * contrast * (gauss_left + gauss_right)
                slope_row[3] = -contrast * (left * gauss_left - right * gauss_right) / values[3]
                slope_row[4], slope_row[5], slope_row[6] = 1.0, s, s * s
                slope_row[7], slope_row[8] = d, d * s
                slope_row[9], slope_row[10], slope_row[11] = shape, shape * s, shape * s * s
                weight = 1.0 / expected
                total += weight * rest * rest
                count += 1
                for i in range(first, SIZE):
                    weighted = weight * slope_row[i]
                    slope[i] += weighted * rest
                    for j in range(first, i + 1):
                        normal[i, j] += weighted * slope_row[j]
        if count < 20 * SIZE:
            return covariance, misfit, count
        for i in range(SIZE):
            for j in range(i + 1, SIZE):
                normal[i, j] = normal[j, i]
        for i in range(first):
            normal[i, i] = 1.0
        misfit = total / (count - SIZE)
        inverse = np.linalg.inv(normal)
        change = inverse @ slope
        for i in range(SIZE):
            values[i] += change[i]
            for j in range(SIZE):
                covariance[i, j] = inverse[i, j]
        values[2] = min(max(values[2], 0.5 * width), 2.0 * width)
        values[3] = min(max(values[3], 0.3), 0.5 * width)
        if step > 1 and abs(change[0]) + abs(change[1]) < SETTLED_PIXELS:
            break
    return covariance, misfit, count
