"""Noise removal that keeps edges (thesis Sec. 6.3.3, prefiltering)."""

from __future__ import annotations

import numpy as np
from numba import njit


def hybrid_median(image: np.ndarray) -> np.ndarray:
    """Return the median of three medians: of the row, column and diagonals through each pixel of a 5 x 5 neighbourhood.

    Returns
    -------
    (rows, columns) float32 array
        The two outermost pixels on each side are those of the image.
    """
    source = np.ascontiguousarray(image, dtype=np.float32)
    result = source.copy()
    _hybrid(source, result)
    return result


@njit(inline="always")
def _middle3(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


@njit(inline="always")
def _middle5(a: float, b: float, c: float, d: float, e: float) -> float:
    low = max(min(a, b), min(c, d))
    high = min(max(a, b), max(c, d))
    return _middle3(low, high, e)


@njit(cache=True, fastmath=True)
def _hybrid(image: np.ndarray, result: np.ndarray) -> None:
    rows, columns = image.shape
    for r in range(2, rows - 2):
        for c in range(2, columns - 2):
            here = image[r, c]
            row = _middle5(image[r, c - 2], image[r, c - 1], image[r, c + 1], image[r, c + 2], here)
            column = _middle5(image[r - 2, c], image[r - 1, c], image[r + 1, c], image[r + 2, c], here)
            falling = _middle5(image[r - 2, c - 2], image[r - 1, c - 1], image[r + 1, c + 1], image[r + 2, c + 2], here)
            rising = _middle5(image[r - 2, c + 2], image[r - 1, c + 1], image[r + 1, c - 1], image[r + 2, c - 2], here)
            result[r, c] = _middle3(row, column, 0.5 * (falling + rising))
