"""Pixels before anything is measured in them: exposed as they should be, and single dead ones repaired."""

from __future__ import annotations

import numpy as np
from numba import njit

from hil.errors import UnusableInputError

SAMPLED = 4
"""Every so many rows and columns tell how an image is exposed."""

SATURATED_SHARE = 0.05


def check_exposed(image: np.ndarray, fewest: float, why: str) -> None:
    """Refuse an image that is saturated or dark.

    Parameters
    ----------
    image : (rows, columns) array
        Photon counts.
    fewest : float
        Least median [counts].
    why : str
        What needs them.

    Raises
    ------
    UnusableInputError
    """
    sample = np.ascontiguousarray(image[::SAMPLED, ::SAMPLED])
    full = np.iinfo(image.dtype).max if np.issubdtype(image.dtype, np.integer) else np.inf
    if np.mean(sample >= full) > SATURATED_SHARE:
        raise UnusableInputError(f"{np.mean(image >= full):.0%} of the pixels are saturated at {full}; expose less")
    if not np.isfinite(sample).all() or np.mean(sample >= fewest) <= 0.5:
        raise UnusableInputError(f"the image is dark (median {np.median(image):g} counts); {why}")


def counted(image: np.ndarray) -> np.ndarray:
    """Return the image as compiled functions take it: 16 bits as they are, all else as float32; without a copy where it is so already."""
    return np.ascontiguousarray(image, dtype=np.uint16 if image.dtype == np.uint16 else np.float32)


def without_dead_pixels(image: np.ndarray) -> np.ndarray:
    """Replace pixels far outside the range of their eight neighbours by the neighbours' median, in an image of counts."""
    source = np.ascontiguousarray(image)
    clean = source.copy()
    _repair(source, clean)
    return clean


@njit(cache=True, error_model="numpy")
def _repair(image: np.ndarray, clean: np.ndarray) -> None:
    """Repair all but the outermost pixels, which have no neighbours on one side."""
    for row in range(1, image.shape[0] - 1):
        for column in range(1, image.shape[1] - 1):
            low = high = image[row - 1, column - 1]
            for i in range(row - 1, row + 2):
                for j in range(column - 1, column + 2):
                    if i != row or j != column:
                        low, high = min(low, image[i, j]), max(high, image[i, j])
            seen = image[row, column]
            beyond = max(low - seen, seen - high)
            if beyond > 0.0 and beyond > 5.0 * np.sqrt(max(low, 1.0)):
                clean[row, column] = np.median(image[row - 1 : row + 2, column - 1 : column + 2])
