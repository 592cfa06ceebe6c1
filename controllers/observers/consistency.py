"""Consistency of a filter: normalised innovations squared (NIS) against chi-square, and what corrects the published values against theirs.

Innovations that are not white say that something acts which the model lacks; what is published may be right all the same. In a consistent
filter the corrections G K ν of published values G x are white, with the covariance G K S Kᵀ Gᵀ by which the sample narrows their variance
(Kailath 1968). So their sum over a while is as large as the stated variances say, and where it is larger, these are false.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

WINDOW = 64
"""Samples over which NIS is averaged, and in which a correction is forgotten to 1/e: a quarter of a second at 256 Hz."""

FALSE_ALARM = 1e-6
"""Probability that one sample's sum of corrections of one point or angle raises the alarm by chance: of three at 256 Hz once in twenty
minutes if samples were independent, less often as they are not."""

GROUPS = ((0, 3), (3, 6), (6, 9))
"""Among the geometric parameters: focal spot, isocentre, orientation."""


class InnovationMonitor:
    """Averages normalised innovations squared over the last `WINDOW` samples. Allocates nothing while it runs."""

    def __init__(self, window: int = WINDOW) -> None:
        self._nis = np.zeros(window)
        self._measured = np.zeros(window)
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._nis[:] = 0.0
        self._measured[:] = 0.0
        self._next = 0

    def step(self, nis: float, measured: float) -> float:
        """Return the mean NIS per measurement over the window: 1 when consistent, NaN without a measurement."""
        self._nis[self._next] = nis
        self._measured[self._next] = measured
        self._next = (self._next + 1) % len(self._nis)
        freedom = float(self._measured.sum())
        return float(self._nis.sum()) / freedom if freedom else math.nan


class CorrectionMonitor:
    """Compares the recent corrections of the geometric parameters with their variances.

    The squared norm of a point's correction is a weighted sum of chi-squares; far out it is largest where one direction has all the weight.
    """

    def __init__(self, window: float = WINDOW, false_alarm: float = FALSE_ALARM) -> None:
        self._kept = math.exp(-1.0 / window)
        self._most = float(stats.norm.isf(0.5 * false_alarm)) ** 2
        self._sum, self._variance = np.zeros(9), np.zeros(9)

    def reset(self) -> None:
        """Forget all samples."""
        self._sum[:] = 0.0
        self._variance[:] = 0.0

    def step(self, correction: np.ndarray, variance: np.ndarray) -> bool:
        """Tell whether a sample's correction (9,), with its variance (9,), and those before are too large for chance."""
        self._sum *= self._kept
        self._sum += correction
        self._variance *= self._kept**2
        self._variance += variance
        return any(
            float(self._sum[low:high] @ self._sum[low:high]) > self._most * float(self._variance[low:high].sum()) for low, high in GROUPS
        )


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
