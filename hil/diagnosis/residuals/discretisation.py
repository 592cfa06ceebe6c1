"""A machine's equations over one row: what its state becomes, and what efforts do that are held or rise meanwhile."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.residuals.propagation import exactly_compiled

TAYLOR = 12
"""Order of the matrix exponential's series, after halving until the step is below one half: its error is 0.5^13/13! = 2e-14."""


@exactly_compiled
def discretised(
    period: float, inverses: np.ndarray, stiffnesses: np.ndarray, dampings: np.ndarray, felt: np.ndarray, through: np.ndarray,
    corners: np.ndarray, transition: np.ndarray, of_effort: np.ndarray, of_rise: np.ndarray,
) -> None:  # fmt: skip
    """Write what a period does to positions, speeds and low passes, and what efforts do that are held or rise over it.

    `felt` (L, i, 2n) and `through` (L, i, n) are what IMU channels feel of positions and speeds, and of efforts; `corners` (i,) are their
    low passes' [rad/s]. The state is (positions, speeds, efforts as they stand, low passes): transition (L, 3n + i, 3n + i), with efforts
    that stay; of_effort and of_rise (L, 3n + i, n), without.
    """
    count, n, _ = inverses.shape
    imus = len(corners)
    size = 4 * n + imus
    f, term, total, product = np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size)), np.zeros((size, size))
    of_position, of_speed = np.zeros((n, n)), np.zeros((n, n))
    low, rise = 3 * n, 3 * n + imus
    for k in range(count):
        for i in range(size):
            for j in range(size):
                f[i, j] = 0.0
                term[i, j] = total[i, j] = 1.0 if i == j else 0.0
        np.dot(inverses[k], stiffnesses[k], of_position)
        np.dot(inverses[k], dampings[k], of_speed)
        for i in range(n):
            f[i, n + i] = period
            f[2 * n + i, rise + i] = 1.0
            for j in range(n):
                f[n + i, j] = -period * of_position[i, j]
                f[n + i, n + j] = -period * of_speed[i, j]
                f[n + i, 2 * n + j] = period * inverses[k, i, j]
        for c in range(imus):
            pull = period * corners[c]
            f[low + c, low + c] = -pull
            for j in range(2 * n):
                f[low + c, j] = pull * felt[k, c, j]
            for j in range(n):
                f[low + c, 2 * n + j] = pull * through[k, c, j]
        norm = 1.0
        for i in range(n):
            norm = max(norm, abs(f[n + i, n + i]) + np.sqrt(abs(f[n + i, i]) * period))
        for c in range(imus):
            norm = max(norm, period * corners[c])
        halvings = 0
        while norm > 0.5 and halvings < 30:
            norm *= 0.5
            halvings += 1
        share = 2.0**halvings
        for i in range(size):
            for j in range(size):
                f[i, j] /= share
        for order in range(1, TAYLOR + 1):
            np.dot(term, f, product)
            for i in range(size):
                for j in range(size):
                    term[i, j] = product[i, j] / order
                    total[i, j] += term[i, j]
        for _ in range(halvings):
            np.dot(total, total, product)
            total, product = product, total
        for i in range(rise):
            for j in range(rise):
                transition[k, i, j] = total[i, j]
            for j in range(n):
                stays = 2 * n <= i < 3 * n
                of_effort[k, i, j] = 0.0 if stays else total[i, 2 * n + j]
                of_rise[k, i, j] = 0.0 if stays else total[i, rise + j]
