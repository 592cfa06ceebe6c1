"""Lines through the pieces of grooves, with covariances that count what the pieces and the plate as a whole do not agree on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from hil.imaging.markers.plane import Plane

ASIDE = 1.0 / np.sqrt(3.0)
"""In half lengths: at these places on either side of the middle a line's errors are uncorrelated and of one size."""


@dataclass(frozen=True)
class FineLine:
    """across = offset + slope * (along - middle) [pixel].

    Attributes
    ----------
    offset, slope, middle : float
    covariance : (2, 2) array
        Of offset and slope.
    width, blur : float
        Of the profile [pixel].
    half_length : float
        Of what was used of it [pixel].
    """

    offset: float
    slope: float
    middle: float
    covariance: np.ndarray
    width: float
    blur: float
    half_length: float

    def at(self, along: np.ndarray | float) -> np.ndarray | float:
        """Return where the line is."""
        return self.offset + self.slope * (along - self.middle)


def beyond_chance(square: np.ndarray | float, freedom: np.ndarray | float) -> np.ndarray:
    """Return the factor on a variance that a mean square of so many degrees of freedom asks for, 1 at least.

    A mean square is above 1 half the time where 1 is right: only what is beyond its own standard deviation counts.
    """
    return np.asarray(np.maximum(square - np.sqrt(2.0 / freedom), 1.0))


def line_through(along: np.ndarray, across: np.ndarray, sigma: np.ndarray, shape: tuple[float, float]) -> FineLine:
    """Fit a line to places by least squares.

    Parameters
    ----------
    along, across, sigma : (P,) arrays
        Three at least, and their deviations across [pixel].
    shape : (2,)
        Width and blur of the profile.
    """
    weight = 1.0 / sigma**2
    middle, half = 0.5 * (along.min() + along.max()), 0.5 * np.ptp(along)
    aside = along - middle
    weighted = weight * aside
    total, first, second = weight.sum(), weighted.sum(), weighted @ aside
    covariance = np.array([[second, -first], [-first, total]]) / (total * second - first**2)
    offset, slope = covariance @ np.array([weight @ across, weighted @ across])
    rest = across - offset - slope * aside
    freedom = max(len(along) - 2, 1)
    scatter = float(beyond_chance(float(weight @ rest**2) / freedom, freedom))
    return FineLine(float(offset), float(slope), float(middle), covariance * scatter, *shape, float(half))


def widened(lines: dict[int, FineLine], plane: Plane) -> dict[int, FineLine]:
    """Return the lines with what they miss the plane by, beyond their covariances, counted in.

    A structure along a groove moves its pieces together, so their scatter about the line does not show it; that the lines do not fit one
    flat plate does. Its variance is that with which the lines' squared misses are as many as their degrees of freedom (DerSimonian, Laird
    1986).
    """
    numbers = np.array(sorted(lines))
    half = np.array([lines[k].half_length for k in numbers])
    along = np.array([lines[k].middle for k in numbers])[:, None] + half[:, None] * np.array([-ASIDE, ASIDE])
    across = np.array([lines[k].at(row) for k, row in zip(numbers, along, strict=True)])
    step = along - along.mean(axis=1, keepdims=True)
    variance = np.array([lines[k].covariance[0, 0] + 2.0 * d * lines[k].covariance[0, 1] + d**2 * lines[k].covariance[1, 1]
                         for k, d in zip(numbers, step, strict=True)])  # fmt: skip
    which, freedom = np.repeat(numbers, 2), 2 * len(numbers) - 8
    if freedom <= 0:
        return lines
    more = 0.0

    def excess(further: float) -> float:
        sigma = np.sqrt(variance.ravel() + further)
        rest = plane.least_squares(which, along.ravel(), across.ravel(), sigma)
        return float(np.sum((rest / sigma) ** 2)) - freedom

    if excess(0.0) > 0.0:
        highest = float(variance.max())
        while excess(highest) > 0.0:
            highest *= 4.0
        more = float(brentq(excess, 0.0, highest, rtol=1e-2))
    return {
        k: replace(line, covariance=line.covariance + more * np.diag([0.5, 0.5 / (ASIDE * max(line.half_length, 1.0)) ** 2]))
        for k, line in lines.items()
    }
