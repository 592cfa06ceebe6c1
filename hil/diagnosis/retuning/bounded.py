"""Least squares within bounds, from the normal equations."""

from __future__ import annotations

import numpy as np
import scipy.optimize

ROUNDING = 1e-10
"""Added to a scaled diagonal: directions that nothing determines stay where they are."""
PASSES = 5
"""Times that every unknown may change its set on average: the active sets of machines with badly determined numbers are found in two."""
FARTHEST = 1e30
"""Stands for an infinite bound."""


def bounded_least_squares(squares: np.ndarray, slopes: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return x (n,) in [low, high] that makes x'Ax/2 - b'x least, A = `squares` (n, n) and b = `slopes` (n,).

    Where low is not below high, x stays at low.
    """
    if not len(slopes):
        return np.zeros(0)
    scale = np.sqrt(np.maximum(np.abs(np.diag(squares)), 1e-300))
    scaled = squares / scale[:, None] / scale
    try:
        root = np.linalg.cholesky(scaled + ROUNDING * np.eye(len(slopes)))
    except np.linalg.LinAlgError:  # where stretches were subtracted, a direction that they alone determine may be below zero
        values, vectors = np.linalg.eigh(scaled)
        root = np.linalg.cholesky(vectors * (np.maximum(values, 0.0) + 2.0 * ROUNDING) @ vectors.T)
    target = np.linalg.solve(root, slopes / scale)
    low = np.where(np.isinf(low), -FARTHEST, low)
    high = np.maximum(np.where(np.isinf(high), FARTHEST, high), low + 1e-12 * (1.0 + np.abs(low)))
    free = np.linalg.solve(root.T, target) / scale
    if np.all((free >= low) & (free <= high)):
        return free
    found = scipy.optimize.lsq_linear(root.T, target, (low * scale, high * scale), method="bvls", max_iter=PASSES * len(slopes))
    inside: np.ndarray = np.clip(found.x / scale, low, high)
    return inside
