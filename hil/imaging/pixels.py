"""Repair of single pixels before anything is measured in an image."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=bool)


def without_dead_pixels(image: np.ndarray) -> np.ndarray:
    """Replace pixels far outside the range of their eight neighbours by the neighbours' median, in an image of counts."""
    low = ndimage.minimum_filter(image, footprint=NEIGHBOURS)
    high = ndimage.maximum_filter(image, footprint=NEIGHBOURS)
    beyond = np.maximum(low - image, image - high)
    rows, columns = np.nonzero(beyond > 5.0 * np.sqrt(np.maximum(low, 1.0)))
    clean = image.copy()
    for row, column in zip(rows, columns, strict=True):
        around = image[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        clean[row, column] = np.median(around)
    return clean
