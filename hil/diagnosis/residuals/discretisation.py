"""A machine's equations over one row: what its state becomes, and what efforts do that are held or rise meanwhile."""

from __future__ import annotations

import numba
import numpy as np

TAYLOR = 12
"""Order of the matrix exponential's series, after halving until the step is below one half: its error is 0.5^13/13! = 2e-14."""


@numba.njit(cache=True, fastmath=False)
def discretised(
    period: float,
    inverses: np.ndarray,
    stiffnesses: np.ndarray,
    dampings: np.ndarray,
    felt: np.ndarray,
    through: np.ndarray,
    corners: np.ndarray,
    transition: np.ndarray,
    of_effort: np.ndarray,
    of_rise: np.ndarray,
) -> None:
    """Write what a period does to positions, speeds and low passes, and what efforts do that are held or rise over it.

    `felt` (L, i, 2n) and `through` (L, i, n) are what IMU channels feel of positions and speeds, and of efforts; `corners` (i,) are their
    low passes' [rad/s]. The state is (positions, speeds, efforts as they stand, low passes): transition (L, 3n + i, 3n + i), with efforts
    that stay; of_effort and of_rise (L, 3n + i, n), without.
    """
    count, n, _ = inverses.shape
    imus = len(corners)
    size = 4 * n + imus
    f = np.zeros((size, size))
    low, rise = 3 * n, 3 * n + imus
    for k in range(count):
        f[:] = 0.0
        for i in range(n):
            f[i, n + i] = period
            f[2 * n + i, rise + i] = 1.0
        f[n : 2 * n, :n] = -period * np.dot(inverses[k], stiffnesses[k])
        f[n : 2 * n, n : 2 * n] = -period * np.dot(inverses[k], dampings[k])
        f[n : 2 * n, 2 * n : 3 * n] = period * inverses[k]
        for c in range(imus):
            pull = period * corners[c]
            f[low + c, low + c] = -pull
            f[low + c, : 2 * n] = pull * felt[k, c]
            f[low + c, 2 * n : 3 * n] = pull * through[k, c]
        norm = 1.0
        for i in range(n):
            norm = max(norm, abs(f[n + i, n + i]) + np.sqrt(abs(f[n + i, i]) * period))
        for c in range(imus):
            norm = max(norm, period * corners[c])
        halvings = 0
        while norm > 0.5 and halvings < 30:
            norm *= 0.5
            halvings += 1
        term = np.eye(size)
        total = np.eye(size)
        small = f / 2.0**halvings
        for order in range(1, TAYLOR + 1):
            term = np.dot(term, small) / order
            total += term
        for _ in range(halvings):
            total = np.dot(total, total)
        transition[k] = total[:rise, :rise]
        of_effort[k] = total[:rise, 2 * n : 3 * n]
        of_rise[k] = total[:rise, rise:]
        for i in range(n):
            of_effort[k, 2 * n : 3 * n, i] = 0.0
            of_rise[k, 2 * n : 3 * n, i] = 0.0
