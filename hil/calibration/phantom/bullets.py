"""Bullets in an X-ray image: dark round shadows, found, sized and centred to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import ndimage

from hil.errors import UnusableInputError
from hil.imaging.pixels import check_exposed, counted, without_dead_pixels

SHADOW = 0.5
"""A pixel belongs to a bullet's core where it is darker than this share of the way from the background to a bullet's middle."""

ROUND = 1.6
"""Ratio of a shadow's long to short second moment above which it is no single bullet: two that overlap, a wire, an edge."""

COARSE_RADIUS = 1.75
"""Shadows are looked for where they are about so large [pixel]; finer pixels are put together for it, and centre what was found."""

DARKEST = 20
"""How dark a bullet's middle is, so many pixels of the whole image tell: the darkest alone could be noise."""

ROUGH = 4
"""The background is found in so many coarse pixels put together, in each direction."""

STEPS, SETTLED_PIXELS = 8, 1e-3
"""A soft disc is moved until it is centred."""

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
    if image.ndim != 2:
        raise UnusableInputError(f"an image has rows and columns; this one has shape {image.shape}")
    check_exposed(image, 20.0, "a calibration needs a few hundred photons a pixel")
    full = counted(image)
    factor = max(1, int(radius_pixels / COARSE_RADIUS))
    found = _looked_for(_put_together(full, factor), radius_pixels / factor, max(3, DARKEST // factor**2))
    pixels, variances, doubtful = [], [], [_finer(center, factor) for center in found.doubtful]
    for coarse in found.pixels:
        center, variance = _centered(full, found.background, factor, _finer(coarse, factor), radius_pixels)
        if np.isfinite(variance):
            pixels.append(center)
            variances.append(variance)
        else:
            doubtful.append(center)
    return Bullets(np.array(pixels).reshape(-1, 2), np.array(variances), np.array(doubtful).reshape(-1, 2))


@dataclass(frozen=True)
class _Shadows:
    """Centres (n, 2) of single bullets, of other shadows (m, 2), and the background (rows, columns), in coarse pixels."""

    pixels: np.ndarray
    doubtful: np.ndarray
    background: np.ndarray


@njit(cache=True)
def _put_together(image: np.ndarray, factor: int) -> np.ndarray:
    """Return the means (rows // factor, columns // factor) of blocks of pixels."""
    together = np.zeros((image.shape[0] // factor, image.shape[1] // factor), dtype=np.float32)
    sums = np.zeros(together.shape[1])
    for row in range(together.shape[0]):
        sums[:] = 0.0
        for i in range(row * factor, (row + 1) * factor):
            for column in range(together.shape[1]):
                for j in range(column * factor, (column + 1) * factor):
                    sums[column] += image[i, j]
        for column in range(together.shape[1]):
            together[row, column] = sums[column] / factor**2
    return together


def _finer(center: np.ndarray, factor: int) -> np.ndarray:
    """Return a place in fine pixels; both count from the middle of their first pixel."""
    finer: np.ndarray = factor * center + 0.5 * (factor - 1)
    return finer


def _looked_for(image: np.ndarray, radius_pixels: float, rank: int) -> _Shadows:
    clean = without_dead_pixels(image)
    wide = 2 * int(np.ceil(4.0 * radius_pixels)) + 1
    rough = ndimage.percentile_filter(_put_together(clean, ROUGH), 80, size=max(3, wide // ROUGH))
    background = _spread(rough, ROUGH, *image.shape)
    depth = np.log(np.maximum(background, 1.0)) - np.log(np.maximum(clean, 1.0))
    smooth = ndimage.gaussian_filter(depth, 0.25 * radius_pixels)
    noise = 1.4826 * float(np.median(np.abs(smooth - np.median(smooth))))
    darkest = float(np.partition(smooth.ravel(), -rank)[-rank])
    threshold = SHADOW * darkest
    nothing = np.empty((0, 2))
    if threshold < 6.0 * noise:
        return _Shadows(nothing, nothing, background)
    labels, count = ndimage.label(smooth > threshold)
    expected_area = np.pi * radius_pixels**2
    pixels: list[np.ndarray] = []
    doubtful: list[np.ndarray] = []
    for area, spread, *center in _cores(labels, count):
        if area < SIZE_RANGE[0] * expected_area:
            continue
        place = np.array(center)
        single = _inside(place, 2.0 * radius_pixels, image.shape) and area <= SIZE_RANGE[1] * expected_area and spread <= ROUND
        (pixels if single else doubtful).append(place)
    return _Shadows(np.array(pixels).reshape(-1, 2), np.array(doubtful).reshape(-1, 2), background)


@njit(cache=True)
def _spread(rough: np.ndarray, factor: int, rows: int, columns: int) -> np.ndarray:
    """Return an image (rows, columns), linear between the middles of blocks of pixels."""
    result = np.zeros((rows, columns), dtype=np.float32)
    for i in range(rows):
        for j in range(columns):
            result[i, j] = _between(rough, (i + 0.5) / factor - 0.5, (j + 0.5) / factor - 0.5)
    return result


@njit(cache=True, error_model="numpy")
def _cores(labels: np.ndarray, count: int) -> np.ndarray:
    """Return area, ratio of the long to the short second moment (square rooted), column and row of each labelled shadow (count, 4)."""
    sums = np.zeros((count + 1, 6))
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            if labels[i, j] > 0:
                each = sums[labels[i, j]]
                each[0] += 1.0
                each[1] += j
                each[2] += i
                each[3] += j * j
                each[4] += i * i
                each[5] += i * j
    result = np.ones((count, 4))
    for k in range(count):
        area, by_u, by_v, uu, vv, uv = sums[k + 1]
        u, v = by_u / area, by_v / area
        result[k, 0], result[k, 2], result[k, 3] = area, u, v
        if area >= 3.0:  # a pixel is itself 1/12 wide, squared
            uu, vv = (uu - area * u * u) / (area - 1.0) + 1.0 / 12.0, (vv - area * v * v) / (area - 1.0) + 1.0 / 12.0
            uv = (uv - area * u * v) / (area - 1.0)
            half, apart = 0.5 * (uu + vv), np.hypot(0.5 * (uu - vv), uv)
            result[k, 1] = np.sqrt((half + apart) / (half - apart))
    return result


def _inside(center: np.ndarray, margin: float, shape: tuple[int, int]) -> bool:
    return bool(margin < center[0] < shape[1] - 1 - margin and margin < center[1] < shape[0] - 1 - margin)


@njit(cache=True, error_model="numpy")
def _centered(image: np.ndarray, background: np.ndarray, factor: int, start: np.ndarray, radius: float) -> tuple[np.ndarray, float]:
    """Return the centre of depth within a soft disc that is moved until it is centred; variance from the counts' Poisson noise.

    NaN where the disc is not darker than its rim: no shadow of a bullet.
    """
    reach = int(np.ceil(2.2 * radius))
    size = 2 * reach + 1
    position, variance = start.copy(), np.nan
    counts, depth, rim = np.zeros((size, size)), np.zeros((size, size)), np.zeros(size * size)
    left = top = -size  # no window
    for _ in range(STEPS):
        if left != int(np.rint(position[0])) - reach or top != int(np.rint(position[1])) - reach:
            left, top = int(np.rint(position[0])) - reach, int(np.rint(position[1])) - reach
            _deep(image, background, factor, left, top, counts, depth)
        on_rim = 0
        for i in range(size):
            for j in range(size):
                if counts[i, j] == 0.0:
                    continue
                distance = (left + j - position[0]) ** 2 + (top + i - position[1]) ** 2
                if (1.6 * radius) ** 2 < distance < (2.2 * radius) ** 2:
                    rim[on_rim] = depth[i, j]
                    on_rim += 1
        level = np.median(rim[:on_rim]) if on_rim else 0.0
        total = by_u = by_v = scatter = 0.0
        for i in range(size):
            for j in range(size):
                if counts[i, j] == 0.0:
                    continue
                du, dv = left + j - position[0], top + i - position[1]
                weight = min(max(0.5 + (1.5 * radius - np.hypot(du, dv)) / radius, 0.0), 1.0)
                mass = weight * (depth[i, j] - level)
                total += mass
                by_u += mass * du
                by_v += mass * dv
                scatter += (weight * du) ** 2 / counts[i, j]
        if not total > 0.0:
            return position, np.nan
        variance = scatter / total**2
        position[0] += by_u / total
        position[1] += by_v / total
        if np.hypot(by_u, by_v) < SETTLED_PIXELS * total:
            break
    return position, variance


@njit
def _deep(image: np.ndarray, background: np.ndarray, factor: int, left: int, top: int, counts: np.ndarray, depth: np.ndarray) -> None:
    """Overwrite counts and depth of a window; counts are 0 where it is outside of the image."""
    for i in range(counts.shape[0]):
        for j in range(counts.shape[1]):
            row, column = top + i, left + j
            counts[i, j] = 0.0
            if row < 0 or column < 0 or row >= image.shape[0] or column >= image.shape[1]:
                continue
            counts[i, j] = max(_repaired(image, row, column), 1.0)
            behind = max(_between(background, (row + 0.5) / factor - 0.5, (column + 0.5) / factor - 0.5), 1.0)
            depth[i, j] = np.log(behind / counts[i, j])


@njit(inline="always")
def _between(image: np.ndarray, row: float, column: float) -> float:
    """Return the value at a place between pixels, linear; at the border that of the border."""
    row, column = min(max(row, 0.0), image.shape[0] - 1.0), min(max(column, 0.0), image.shape[1] - 1.0)
    i, j = min(int(row), image.shape[0] - 2), min(int(column), image.shape[1] - 2)
    down, right = row - i, column - j
    above = image[i, j] + right * (image[i, j + 1] - image[i, j])
    below = image[i + 1, j] + right * (image[i + 1, j + 1] - image[i + 1, j])
    return float(above + down * (below - above))


@njit(inline="always")
def _repaired(image: np.ndarray, row: int, column: int) -> float:
    """Return a pixel's value, or its neighbours' mean less the two outermost where it is far outside their range: it is dead."""
    low, high, total, number = np.inf, -np.inf, 0.0, 0
    for i in range(max(0, row - 1), min(image.shape[0], row + 2)):
        for j in range(max(0, column - 1), min(image.shape[1], column + 2)):
            if i != row or j != column:
                value = float(image[i, j])
                low, high, total, number = min(low, value), max(high, value), total + value, number + 1
    seen = float(image[row, column])
    beyond = max(low - seen, seen - high)
    return (total - low - high) / (number - 2) if beyond > 5.0 * np.sqrt(max(low, 1.0)) else seen
