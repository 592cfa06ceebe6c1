"""Rejection of lines that are not the plate's: whatever is straight and flat on the plate is imaged by one homography."""

from __future__ import annotations

import numpy as np

from hil.imaging.detector import Detector
from hil.imaging.markers.plates import MarkerPlate
from hil.imaging.markers.profile import FineLine

LIMIT_SIGMA = 6.0
LIMIT_PIXELS = 0.15
"""A line is refused if it misses where all others put it by more than LIMIT_SIGMA deviations and LIMIT_PIXELS: a plate's grooves are cut
to a few micrometres, and pixels cost more than photons do."""


def refused_lines(lines: dict[int, FineLine], plate: MarkerPlate, detector: Detector) -> dict[int, str]:
    """Return number and reason of the lines that miss the plane that the others agree on, the worst first."""
    numbers = sorted(lines)
    # Twice the places on either side of the middle where offset and slope are uncorrelated and weigh the same.
    aside = np.array([[-1.0, 1.0]]) / np.sqrt(3.0)
    half = np.array([lines[k].half_length for k in numbers])[:, None]
    measured = np.array([[lines[k].offset, lines[k].slope] for k in numbers])
    seen = measured[:, :1] + measured[:, 1:] * half * aside
    sigma = np.array([np.sqrt(lines[k].covariance[0, 0]) for k in numbers])
    plane = _Plane(lines, numbers, plate, detector, half * aside)
    present = np.ones(len(numbers), dtype=bool)
    refused: dict[int, str] = {}
    while present.sum() > 5:
        leave_out = np.full(len(numbers), -np.inf)
        miss = np.zeros(len(numbers))
        predicted = plane.fitted(seen, sigma, present)
        rest = np.abs(seen - predicted).max(axis=1)
        for k in np.flatnonzero(present):
            miss[k] = rest[k]
            if rest[k] > LIMIT_SIGMA * sigma[k] and rest[k] > LIMIT_PIXELS:
                leave_out[k] = rest[k] / sigma[k]
        worst = int(np.argmax(leave_out))
        if not np.isfinite(leave_out[worst]):
            break
        present[worst] = False
        refused[numbers[worst]] = f"{miss[worst]:.2f} pixels from where the other lines put it"
    return refused


class _Plane:
    """Homography from plate to image, fitted to lines by Gauss-Newton from the affine map that fits them."""

    def __init__(self, lines: dict[int, FineLine], numbers: list[int], plate: MarkerPlate, detector: Detector, aside: np.ndarray) -> None:
        upright = np.array([k < len(plate.x_m) for k in numbers])
        ends = plate.ends_m()[numbers, :, :2] / np.abs(plate.half_m).max()
        self._ends = np.concatenate([ends, np.ones((*ends.shape[:2], 1))], axis=2)  # homogeneous
        self._along = np.array([[lines[k].middle] for k in numbers]) + aside
        self._upright = upright
        self._center = np.array([(detector.columns - 1) / 2.0, (detector.rows - 1) / 2.0])
        self._scale = 0.5 * detector.columns

    def fitted(self, seen: np.ndarray, sigma: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Return places (lines, 2) across each line at its two places along, after a fit to those present."""
        homography = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        weight = np.where(present, 1.0 / sigma, 0.0)[:, None]
        for _ in range(8):
            at = self._across(homography)
            jacobian = np.stack([(self._across(homography + step) - at) / 1e-6 for step in 1e-6 * np.eye(8)], axis=-1)
            change = np.linalg.lstsq((jacobian * weight[..., None]).reshape(-1, 8), ((seen - at) * weight).ravel(), rcond=None)[0]
            homography = homography + change
            if np.abs(change).max() < 1e-9:
                break
        return self._across(homography)

    def _across(self, values: np.ndarray) -> np.ndarray:
        image = self._ends @ np.append(values, 1.0).reshape(3, 3).T
        points = self._center + self._scale * image[..., :2] / image[..., 2:]
        along = np.where(self._upright[:, None], points[..., 1], points[..., 0])
        across = np.where(self._upright[:, None], points[..., 0], points[..., 1])
        slope = (across[:, 1] - across[:, 0]) / (along[:, 1] - along[:, 0])
        interpolated: np.ndarray = across[:, :1] + slope[:, None] * (self._along - along[:, :1])
        return interpolated
