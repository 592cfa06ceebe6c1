"""Bullets in an X-ray image: dark round shadows, found, sized and centred to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from hil.errors import UnusableInputError
from hil.imaging.pixels import without_dead_pixels

SHADOW = 0.5
"""A pixel belongs to a bullet's core where it is darker than this share of the way from the background to a bullet's middle."""

ROUND = 1.6
"""Ratio of a shadow's long to short second moment above which it is no single bullet: two that overlap, a wire, an edge."""

SIZE_RANGE = (0.225, 1.9)
"""A single bullet's core has an area in this range, relative to what its drawing and the magnification say."""


@dataclass(frozen=True)
class Bullets:
    """Shadows of one image.

    Attributes
    ----------
    pixels : (n, 2) array
        Column and row of each centre.
    variance : (n,) array
        Of each coordinate [pixel^2], from the photons counted.
    doubtful : (m, 2) array
        Shadows that are no single bullet: overlaps, or cut by the border.
    """

    pixels: np.ndarray
    variance: np.ndarray
    doubtful: np.ndarray


def find_bullets(image: np.ndarray, radius_pixels: float) -> Bullets:
    """Find every bullet of one size.

    Parameters
    ----------
    image : (rows, columns) array
        Photon counts or any linear unit; shadows are dark.
    radius_pixels : float
        Expected radius of a shadow.

    Raises
    ------
    UnusableInputError
        The image is saturated, empty or not of two dimensions.
    """
    image = _usable(image)
    clean = without_dead_pixels(image)
    wide = 2 * int(np.ceil(4.0 * radius_pixels)) + 1
    coarse = 4
    background = ndimage.zoom(
        ndimage.percentile_filter(ndimage.uniform_filter(clean, coarse)[::coarse, ::coarse], 80, size=max(3, wide // coarse)),
        coarse,
        order=1,
        grid_mode=True,
        mode="nearest",
    )[: image.shape[0], : image.shape[1]]
    background = np.pad(background, ((0, image.shape[0] - background.shape[0]), (0, image.shape[1] - background.shape[1])), mode="edge")
    depth = np.log(np.maximum(background, 1.0)) - np.log(np.maximum(clean, 1.0))
    smooth = ndimage.gaussian_filter(depth, 0.25 * radius_pixels)
    noise = 1.4826 * float(np.median(np.abs(smooth - np.median(smooth))))
    darkest = float(np.partition(smooth.ravel(), -20)[-20])
    threshold = SHADOW * darkest
    if threshold < 6.0 * noise:
        return Bullets(np.empty((0, 2)), np.empty(0), np.empty((0, 2)))
    labels, count = ndimage.label(smooth > threshold)
    expected_area = np.pi * radius_pixels**2
    pixels, variances, doubtful = [], [], []
    for slices in ndimage.find_objects(labels, count):
        core = smooth[slices] > threshold
        area = float(core.sum())
        if area < SIZE_RANGE[0] * expected_area:
            continue
        center, spread = _moments(core.astype(float), slices)
        if not _inside(center, 2.0 * radius_pixels, image.shape) or area > SIZE_RANGE[1] * expected_area or spread > ROUND:
            doubtful.append(center)
            continue
        fitted = _centroid(depth, center, radius_pixels, noise_of=np.maximum(clean, 1.0))
        if fitted is None:
            doubtful.append(center)
            continue
        pixels.append(fitted[0])
        variances.append(fitted[1])
    return Bullets(np.array(pixels).reshape(-1, 2), np.array(variances), np.array(doubtful).reshape(-1, 2))


def _usable(image: np.ndarray) -> np.ndarray:
    if image.ndim != 2:
        raise UnusableInputError(f"an image has rows and columns; this one has shape {image.shape}")
    values = np.asarray(image, dtype=float)
    full = np.iinfo(image.dtype).max if np.issubdtype(image.dtype, np.integer) else np.inf
    if np.mean(values >= full) > 0.05:
        raise UnusableInputError(f"{np.mean(values >= full):.0%} of the pixels are saturated at {full}; expose less")
    if values.max() <= 0.0 or np.median(values) < 20.0:
        raise UnusableInputError(
            f"the image is dark (median {np.median(values):g} counts); a calibration needs a few hundred photons a pixel"
        )
    return values


def _moments(weights: np.ndarray, slices: tuple[slice, slice]) -> tuple[np.ndarray, float]:
    """Return the centre (column, row) of a shadow, and the ratio of its long to short second moment (square rooted)."""
    rows, columns = np.nonzero(weights > 0)
    center = np.array([columns.mean() + slices[1].start, rows.mean() + slices[0].start])
    if len(rows) < 3:
        return center, 1.0
    moments = np.linalg.eigvalsh(np.cov(np.vstack([columns, rows])) + np.eye(2) / 12.0)
    return center, float(np.sqrt(moments[1] / moments[0]))


def _inside(center: np.ndarray, margin: float, shape: tuple[int, int]) -> bool:
    return bool(margin < center[0] < shape[1] - 1 - margin and margin < center[1] < shape[0] - 1 - margin)


def _centroid(depth: np.ndarray, center: np.ndarray, radius: float, noise_of: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Return the centre of depth within a soft disc that is moved until it is centred; variance from the counts' Poisson noise.

    None where the disc is not darker than its rim: no shadow of a bullet.
    """
    reach = int(np.ceil(2.2 * radius))
    position = center.copy()
    variance = np.nan
    for _ in range(8):
        column, row = (int(value) for value in np.rint(position))
        rows = np.arange(max(0, row - reach), min(depth.shape[0], row + reach + 1))
        columns = np.arange(max(0, column - reach), min(depth.shape[1], column + reach + 1))
        local = depth[np.ix_(rows, columns)]
        du, dv = columns[None, :] - position[0], rows[:, None] - position[1]
        distance = np.hypot(du, dv)
        weight = np.clip(0.5 + (1.5 * radius - distance) / radius, 0.0, 1.0)
        rim = (distance > 1.6 * radius) & (distance < 2.2 * radius)
        level = np.median(local[rim]) if rim.any() else 0.0
        mass = weight * (local - level)
        total = mass.sum()
        if not total > 0.0:
            return None
        shift = np.array([np.sum(mass * du), np.sum(mass * dv)]) / total
        counts = noise_of[np.ix_(rows, columns)]
        variance = float(np.sum((weight * du) ** 2 / counts) / total**2)
        position = position + shift
        if np.hypot(*shift) < 1e-3:
            break
    return position, variance
