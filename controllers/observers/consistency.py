"""Consistency of a filter: its normalised innovations squared (NIS) against chi-square, at every sample and over a window."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

WINDOW = 64
"""Samples in the alarm's window: a quarter of a second at 256 Hz."""

FALSE_ALARM = 1e-6
"""Probability that a window of a consistent filter raises the alarm: once in an hour of overlapping windows at 256 Hz, at most."""


class InnovationMonitor:
    """Compares the sum of the last `WINDOW` normalised innovations squared with chi-square. Allocates nothing while it runs."""

    def __init__(self, window: int = WINDOW, false_alarm: float = FALSE_ALARM) -> None:
        self._nis = np.zeros(window)
        self._measured = np.zeros(window)
        self._quantile = float(stats.norm.isf(false_alarm))
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._nis[:] = 0.0
        self._measured[:] = 0.0
        self._next = 0

    def step(self, nis: float, measured: float) -> tuple[float, bool]:
        """Return the mean NIS per measurement over the window (1 when consistent), and whether it is too large for chance."""
        self._nis[self._next] = nis
        self._measured[self._next] = measured
        self._next = (self._next + 1) % len(self._nis)
        freedom = float(self._measured.sum())
        if freedom == 0.0:
            return math.nan, False
        total = float(self._nis.sum())
        # Wilson and Hilferty 1931: the cube root of chi-square over its freedom is nearly normal
        part = 2.0 / (9.0 * freedom)
        return total / freedom, total > freedom * (1.0 - part + self._quantile * math.sqrt(part)) ** 3


def share_in_band(nis: np.ndarray, measured: np.ndarray, probability: float = 0.95) -> float:
    """Return the share of samples whose NIS lies in chi-square's central band; rows without a measurement do not count.

    Parameters
    ----------
    nis, measured : (N,) arrays
    """
    known = measured > 0
    tail = 0.5 * (1.0 - probability)
    low, high = stats.chi2.ppf(tail, measured[known]), stats.chi2.ppf(1.0 - tail, measured[known])
    return float(np.mean((nis[known] >= low) & (nis[known] <= high)))
