"""What an image knows of planes through its focal spot: by how much the integral of the attenuation over one changes as it moves.

Grangeat 1991: where an image is weighted with the cosine of each ray's angle to the panel's normal, the derivative of its integral over a
line, across that line, times (D^2 + t^2) / D^2 is the derivative of the plane's integral along its normal; D is the focal spot's distance
from the panel and t the line's from the spot's foot on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import convolve1d, gaussian_filter, map_coordinates

from hil.calibration.consistency.seen_pixels import SeenPixels
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

BLUR = 1.5
"""Of the derivative across a line: standard deviation [pixels]."""
CELLS = 2.0
"""Cells of a table in one such deviation."""
DRAWS = 4
"""Images of noise alone that are tabulated as well: the first ones give its covariance, the last one its slopes."""
REACH = 4.0
"""Standard deviation [pixels] over which an image's error that is no noise (scatter, hardening, starvation) stays alike."""


@dataclass(frozen=True)
class PlaneDerivatives:
    """Derivatives of line integrals of weighted images.

    Tables are over images, the direction of a line's normal, 0 to pi, and its distance from the panel's middle.

    Attributes
    ----------
    known : (N, angles + 1, distances) array
        Of the images.
    noise, relative : (DRAWS, N, angles + 1, distances) arrays
        Of drawn noise, with each pixel's own variance; and of the images times a drawn relative error of deviation one.
    variance, envelope : (N, angles + 1, distances) arrays
        Variances of both.
    step_m : float
        Between distances.
    """

    known: np.ndarray
    noise: np.ndarray
    relative: np.ndarray
    variance: np.ndarray
    envelope: np.ndarray
    step_m: float

    def places(self, image: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where tables hold lines (P, K, 3) of images (P,), n . x [m] + c = 0 with n of length one, and the values' signs."""
        steps, middle = self.known.shape[1] - 1, self.known.shape[2] // 2
        angle = np.arctan2(line[..., 1], line[..., 0])
        turns = np.floor(angle / np.pi)  # a line turned by pi is the same one, seen from behind
        sign = np.where(turns % 2 == 0, 1.0, -1.0)
        number = np.broadcast_to(image[:, None], angle.shape)
        return np.stack([number, (angle / np.pi - turns) * steps, middle - sign * line[..., 2] / self.step_m]), sign


def read(table: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return a table's values at places of `PlaneDerivatives.places`, linear between cells, 0 outside."""
    values: np.ndarray = map_coordinates(table, places, order=1, mode="constant")
    return values


def plane_derivatives(
    images: Sequence[SeenPixels], detector: Detector, beam: ConeBeam, progress: Callable[[int, int], None] = lambda done, total: None
) -> PlaneDerivatives:
    """Tabulate images; `beam` gives the weights, in which its millimetres do not show."""
    random = np.random.default_rng(0)
    deviation = BLUR * detector.pitch_m
    step = deviation / CELLS
    reach = max(np.hypot(*image.at_m.T).max(initial=step) for image in images)
    half = math.ceil((reach + 5.0 * deviation) / step)
    directions = math.ceil(np.pi * reach / step)
    grid = np.arange(-round(4.0 * CELLS), round(4.0 * CELLS) + 1) / CELLS
    kernel = np.exp(-0.5 * grid**2)
    kernel *= -grid / deviation / (kernel.sum() * step)
    tables = np.zeros((2 + 2 * DRAWS, len(images), directions + 1, 2 * half + 1), dtype=np.float32)
    envelope = np.zeros_like(tables[0])
    area = abs(float(np.linalg.det(np.linalg.inv(detector.intrinsic)[:2, :2])))
    for k, image in enumerate(images):
        ray = image.at_m - beam.source_m[k, :2]
        weight = area / np.sqrt(1.0 + (ray**2).sum(axis=1) / beam.source_m[k, 2] ** 2)
        blurred = gaussian_filter(random.standard_normal((DRAWS, detector.rows, detector.columns)).astype(np.float32), (0.0, REACH, REACH))
        pixels = np.round(_pixels(image.at_m, detector)).astype(int)
        relative = 2.0 * np.sqrt(np.pi) * REACH * blurred[:, pixels[:, 1], pixels[:, 0]]
        drawn = np.sqrt(image.variance) * random.standard_normal((DRAWS, len(weight)))
        values = weight * np.vstack([image.integral, drawn, relative * image.integral])
        sums = np.zeros((2 + 2 * DRAWS, directions, 2 * half + 1))
        _gather(image.at_m / step, np.vstack([values, weight**2 * image.variance]), sums)
        tables[:-1, k, :-1] = convolve1d(sums[:-1], kernel, axis=2, mode="constant")
        tables[:-1, k, -1] = -tables[:-1, k, 0, ::-1]
        tables[-1, k, :-1] = convolve1d(sums[-1], kernel**2, axis=1, mode="constant")
        tables[-1, k, -1] = tables[-1, k, 0, ::-1]
        envelope[k] = gaussian_filter((tables[1 + DRAWS : -1, k] ** 2).mean(axis=0), (REACH, REACH))
        progress(k + 1, len(images))
    return PlaneDerivatives(tables[0], tables[1 : 1 + DRAWS], tables[1 + DRAWS : -1], tables[-1], envelope, step)


def _pixels(at_m: np.ndarray, detector: Detector) -> np.ndarray:
    """Return columns and rows (M, 2) of places on the panel."""
    own: np.ndarray = np.column_stack([at_m, np.ones(len(at_m))]) @ detector.intrinsic.T
    pixels: np.ndarray = own[:, :2] / own[:, 2:]
    return pixels


@njit(cache=True)
def _gather(at: np.ndarray, values: np.ndarray, sums: np.ndarray) -> None:
    """Add pixels' values (V, M) to the lines (V, directions, distances) that they lie on, shared between the two next."""
    directions, middle = sums.shape[1], sums.shape[2] // 2
    for n in range(directions):
        cosine, sine = np.cos(n * np.pi / directions), np.sin(n * np.pi / directions)
        for m in range(len(at)):
            place = at[m, 0] * cosine + at[m, 1] * sine + middle
            cell = int(np.floor(place))
            for v in range(len(values)):
                sums[v, n, cell] += values[v, m] * (cell + 1 - place)
                sums[v, n, cell + 1] += values[v, m] * (place - cell)
