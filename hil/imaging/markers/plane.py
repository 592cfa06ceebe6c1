"""What is straight and flat on a plate is imaged by one homography: it tells which pieces of which grooves are spoilt."""

from __future__ import annotations

import copy

import numpy as np

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
        a, b, c = self._image_line(line)
        upright = self._upright[line]
        v = (along - np.where(upright, self._center[1], self._center[0])) / self._scale
        with np.errstate(divide="ignore", invalid="ignore"):  # of no plate: lines along the places asked for
            u = -(np.where(upright, b, a) * v + c) / np.where(upright, a, b)
        result: np.ndarray = u * self._scale + np.where(upright, self._center[0], self._center[1])
        return result

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
            change = np.linalg.lstsq(self._jacobian(line, along, across) * weight[:, None], rest * weight, rcond=None)[0]
            self._values[:8] += change
            if np.abs(change).max() < SETTLED:
                break
        rest = across - self.across(line, along)
        return (rest, _further(rest, sigma)) if np.isfinite(rest).all() else (np.full(len(rest), np.inf), 0.0)

    def least_squares(self, line: np.ndarray, along: np.ndarray, across: np.ndarray, sigma: np.ndarray) -> np.ndarray:
        """Return what all places miss the plane by that fits them best, without refusing any; arguments as in `fitted`."""
        rest = across - self.across(line, along)  # one step: the plane has been fitted to much the same places
        matrix = self._jacobian(line, along, across) / sigma[:, None]
        result: np.ndarray = rest - sigma * (matrix @ np.linalg.lstsq(matrix, rest / sigma, rcond=None)[0])
        return result

    def _points(self, upright: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        pixels = np.where(upright[:, None], np.stack([across, along], axis=1), np.stack([along, across], axis=1))
        return np.concatenate([(pixels - self._center) / self._scale, np.ones((len(along), 1))], axis=1)

    def _image_line(self, line: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        g = self._values.reshape(3, 3)
        first = np.where(self._upright[line][:, None], g[0], g[1]) - self._place[line][:, None] * g[2]
        return first[:, 0], first[:, 1], first[:, 2]

    def _jacobian(self, line: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Return the derivatives (n, 8) of `across` by the homography's values."""
        a, b, _ = self._image_line(line)
        upright = self._upright[line]
        points = self._points(upright, along, across)
        by_line = -points * (self._scale / np.where(upright, a, b))[:, None]
        zero = np.zeros_like(by_line)
        of_rows = np.concatenate([np.where(upright[:, None], by_line, zero), np.where(upright[:, None], zero, by_line)], axis=1)
        return np.concatenate([of_rows, -self._place[line][:, None] * by_line[:, :2]], axis=1)


def _further(rest: np.ndarray, sigma: np.ndarray) -> float:
    """Return what is to be added to sigma, squared, that half of the places are within 0.67 deviations (0 where they are without)."""
    share = rest**2 / 0.6745**2 - sigma**2  # place k is within 0.67 deviations from this on
    return float(np.sqrt(max(np.median(share), 0.0)))
