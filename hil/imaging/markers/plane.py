"""What is straight and flat on a plate is imaged by one homography: it tells which pieces of which grooves are spoilt."""

from __future__ import annotations

import copy

import numpy as np
from numba import njit

from hil.imaging.detector import Detector
from hil.imaging.markers.plates import MarkerPlate

STEPS = 20
CUT = 5.0
"""Places more than this many deviations off lose all weight (Tukey's biweight; 4.7 keeps 95 % efficiency)."""

SETTLED = 1e-7
"""Of the homography's values, which are about 1 where an image is 1 wide."""


class Plane:
    """Homography from the image to the plate, fitted to places across grooves.

    Parameters
    ----------
    plate : MarkerPlate
    detector : Detector
    """

    def __init__(self, plate: MarkerPlate, detector: Detector) -> None:
        self._upright = np.arange(plate.lines) < len(plate.x_m)
        self._place = np.concatenate([plate.x_m, plate.y_m]) / np.abs(plate.half_m).max()
        self._center = np.array([(detector.columns - 1) / 2.0, (detector.rows - 1) / 2.0])
        self._scale = 0.5 * detector.columns
        self._values = np.zeros(9)

    def started(self, line: np.ndarray, along: np.ndarray, across: np.ndarray) -> Plane:
        """Start from the least squares of the equations that are linear in the homography; arguments as in `fitted`."""
        upright, x = self._upright[line], self._place[line]
        points = self._points(upright, along, across)
        zero = np.zeros_like(points)
        rows = np.concatenate([np.where(upright[:, None], points, zero), np.where(upright[:, None], zero, points)], axis=1)
        matrix = np.concatenate([rows, -x[:, None] * points[:, :2]], axis=1)
        self._values = np.append(np.linalg.lstsq(matrix, x, rcond=None)[0], 1.0)
        return self

    def copy(self) -> Plane:
        """Return a plane that can be fitted anew."""
        other = copy.copy(self)
        other._values = self._values.copy()
        return other

    def across(self, line: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Return where grooves `line` (n,) lie across at places `along` them [pixel]."""
        return _across(self._values, self._upright[line], self._place[line], self._center, self._scale, along)

    def fitted(self, line: np.ndarray, along: np.ndarray, across: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, float]:
        """Fit robustly by Gauss-Newton.

        Parameters
        ----------
        line : (n,) int array
            Which groove each place is on.
        along, across, sigma : (n,) arrays
            The places and the deviations across [pixel].

        Returns
        -------
        rest : (n,) array
            Measured less fitted [pixel].
        further : float
            Standard deviation that most places have beyond `sigma` [pixel]: pixels and the spot's shape cost more than photons do.
        """
        for _ in range(STEPS):
            rest = across - self.across(line, along)
            if not np.isfinite(rest).all():  # the places are no plate's
                return np.full(len(rest), np.inf), 0.0
            further = _further(rest, sigma)
            deviation = np.hypot(sigma, further)
            weight = np.maximum(1.0 - (rest / (CUT * deviation)) ** 2, 0.0) / deviation
            change = _least(self._jacobian(line, along, across) * weight[:, None], rest * weight)
            self._values[:8] += change
            if np.abs(change).max() < SETTLED:
                break
        rest = across - self.across(line, along)
        return (rest, _further(rest, sigma)) if np.isfinite(rest).all() else (np.full(len(rest), np.inf), 0.0)

    def least_squares(self, line: np.ndarray, along: np.ndarray, across: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Return what all places miss the plane by that fits them best, without refusing any; arguments as in `fitted`."""
        rest = across - self.across(line, along)  # one step: the plane has been fitted to much the same places
        matrix = self._jacobian(line, along, across) / sigma[:, None]
        result: np.ndarray = rest - sigma * (matrix @ _least(matrix, rest / sigma))
        return result

    def _points(self, upright: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        pixels = np.where(upright[:, None], np.stack([across, along], axis=1), np.stack([along, across], axis=1))
        return np.concatenate([(pixels - self._center) / self._scale, np.ones((len(along), 1))], axis=1)

    def _jacobian(self, line: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, 8) of `across` by the homography's values."""
        return _derivatives(self._values, self._upright[line], self._place[line], self._center, self._scale, along, across)


def _least(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the least squares (8,) by the normal equations, whose numbers are about 1 here, of the least norm where they are singular."""
    result: np.ndarray = np.linalg.lstsq(matrix.T @ matrix, matrix.T @ right, rcond=None)[0]
    return result


@njit(cache=True, error_model="numpy")
def _across(values: np.ndarray, upright: np.ndarray, place: np.ndarray, center: np.ndarray, scale: float, along: np.ndarray) -> np.ndarray:
    """Return `Plane.across` (n,); of no plate it is no number."""
    result = np.empty(len(along))
    for k in range(len(along)):
        own, other = (0, 1) if upright[k] else (1, 0)
        a = values[3 * own + own] - place[k] * values[6 + own]
        b = values[3 * own + other] - place[k] * values[6 + other]
        c = values[3 * own + 2] - place[k] * values[8]
        result[k] = center[own] - scale * (b * (along[k] - center[other]) / scale + c) / a
    return result


@njit(cache=True, error_model="numpy")
def _derivatives(
    values: np.ndarray, upright: np.ndarray, place: np.ndarray, center: np.ndarray, scale: float, along: np.ndarray, across: np.ndarray
) -> np.ndarray:
    """Return `Plane._jacobian` (n, 8)."""
    result = np.zeros((len(along), 8))
    for k in range(len(along)):
        own, other = (0, 1) if upright[k] else (1, 0)
        by = -scale / (values[4 * own] - place[k] * values[6 + own])
        result[k, 3 * own + own] = by * (across[k] - center[own]) / scale
        result[k, 3 * own + other] = by * (along[k] - center[other]) / scale
        result[k, 3 * own + 2] = by
        result[k, 6 + own], result[k, 6 + other] = -place[k] * result[k, 3 * own + own], -place[k] * result[k, 3 * own + other]
    return result


def _further(rest: np.ndarray, sigma: np.ndarray) -> float:
    """Return what is to be added to sigma, squared, that half of the places are within 0.67 deviations (0 where they are without)."""
    share = rest**2 / 0.6745**2 - sigma**2  # place k is within 0.67 deviations from this on
    return float(np.sqrt(max(np.median(share), 0.0)))
