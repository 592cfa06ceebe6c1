"""What an image knows of planes through its focal spot: by how much the integral of the attenuation over one changes as it moves.

Grangeat 1991: where an image is weighted with the cosine of each ray's angle to the panel's normal, the derivative of its integral over a
line, across that line, times (D^2 + t^2) / D^2 is the derivative of the plane's integral along its normal; D is the focal spot's distance
from the panel and t the line's from the spot's foot on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

from hil.extras import extra_package
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam


@dataclass(frozen=True)
class PlaneDerivatives:
    """Derivatives of line integrals of weighted images, tabulated.

    Attributes
    ----------
    table : (N, angles + 1, distances) array
        Per image; over the direction of a line's normal, 0 to pi, and over its distance from the image's middle in pixels.
    detector : Detector
    """

    table: np.ndarray
    detector: Detector

    def at(self, image: np.ndarray, line: np.ndarray) -> np.ndarray:
        """Return derivatives (P, K) of images (P,) at lines (P, K, 3) on the panel, n . x [m] + c = 0 with n of length one."""
        pixels = np.linalg.inv(self.detector.intrinsic)
        own = line @ pixels
        length = np.hypot(own[..., 0], own[..., 1])
        middle = np.array([self.detector.columns // 2, self.detector.rows // 2])
        distance = -(own[..., :2] @ middle + own[..., 2]) / length
        turns = np.floor(np.arctan2(own[..., 1], own[..., 0]) / np.pi)
        angle = np.arctan2(own[..., 1], own[..., 0]) - np.pi * turns  # a line turned by pi is the same one, seen from behind
        sign = np.where(turns % 2 == 0, 1.0, -1.0)
        number, steps = self.table.shape[2] // 2, self.table.shape[1] - 1
        places = [np.broadcast_to(image[:, None], angle.shape), angle / np.pi * steps, sign * distance + number]
        area: float = abs(np.linalg.det(pixels[:2, :2]))
        values: np.ndarray = sign * map_coordinates(self.table, places, order=1, mode="constant") * area / length**2
        return values


def plane_derivatives(
    images: np.ndarray, detector: Detector, beam: ConeBeam, progress: Callable[[int, int], None] = lambda done, total: None
) -> PlaneDerivatives:
    """Tabulate images (N, rows, columns) of line integrals; `beam` gives the weights, in which its millimetres do not show.

    Raises
    ------
    MissingPackageError
        The extra `imaging` is not installed.
    """
    radon = extra_package("skimage.transform", "the consistency of images").radon
    columns, rows = np.meshgrid(np.arange(detector.columns), np.arange(detector.rows))
    points = detector.to_metres(np.stack([columns, rows], axis=-1))
    steps = math.ceil(0.5 * np.pi * math.hypot(detector.rows, detector.columns))  # a pixel at the image's corner
    angles = np.arange(steps) / steps * 180.0
    tables = []
    for k, image in enumerate(images):
        u, v, w = beam.source_m[k]
        cosine = -w / np.sqrt(w**2 + (points[..., 0] - u) ** 2 + (points[..., 1] - v) ** 2)
        lines = gaussian_filter1d(radon(image * cosine, -angles, circle=False), 1.0, axis=0, order=1).T
        middle = lines.shape[1] // 2
        behind = np.zeros(lines.shape[1])
        ahead = np.arange(max(0, 2 * middle - lines.shape[1] + 1), min(2 * middle + 1, lines.shape[1]))
        behind[ahead] = -lines[0, 2 * middle - ahead]
        tables.append(np.vstack([lines, behind]).astype(np.float32))
        progress(k + 1, len(images))
    return PlaneDerivatives(np.array(tables), detector)
