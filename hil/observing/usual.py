"""How large the mean innovations of sound machines become: the ellipsoids beyond which the observer's alarm is raised.

Whitened innovations of a filter whose noise counts friction, play and sensors' errors as random are not white on one machine, on which
these are what they are. So the mean squares of their means come from emulated machines drawn from the file, and so does how far the sum of
squares over these goes: the largest of each scan follow a Gumbel distribution (largest of many, tails as of chi-square), which is
extrapolated to the rate of false alarms that is wanted. Channels count one by one: their covariance, of so few machines, would fit these
alone, and fewer channels may be measured than in the design.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from controllers.observers.consistency import WINDOWS_s

FALSE_ALARMS_per_s = 1.0 / 3600.0
"""On sound machines: one in an hour. One in ten minutes may be: a few minutes of drawn scans tell so rare a thing only to
a factor of several."""

SMALLEST = 1e-6
"""Of a mean square, where a channel of the emulation never surprises."""


def usual_means(scans: Sequence[np.ndarray], rate_Hz: float) -> np.ndarray:
    """Return the squared semi-axes (windows, measurements) of the ellipsoids that means of whitened innovations seldom leave.

    Parameters
    ----------
    scans : sequence of (N, windows, measurements) arrays
        Means of the whitened innovations of scans of sound machines, `controllers.observers.consistency.means`; two scans or more.
    rate_Hz : float
    """
    rows = sum(len(scan) for scan in scans)
    squares = np.maximum(sum(np.sum(scan**2, axis=0) for scan in scans) / rows, SMALLEST)
    largest = np.array([np.max(np.sum(scan**2 / squares, axis=2), axis=0) for scan in scans])
    missed = FALSE_ALARMS_per_s * rows / (rate_Hz * len(scans) * len(WINDOWS_s))  # of one window in one scan
    scale = np.sqrt(6.0) / np.pi * np.std(largest, axis=0, ddof=1)
    limits = stats.gumbel_r.isf(missed, np.mean(largest, axis=0) - np.euler_gamma * scale, scale)
    usual: np.ndarray = squares * limits[:, None]
    return usual
