"""Harmonic filters with a tap at every sample that meet their conditions exactly and pass as little as possible in a band.

A filter longer than its conditions require has spare taps. Here they suppress a whole band, so that a mode which moves within it with
the pose is not excited, and gains stay small. The gains minimise the mean of |G|^2 over the band plus a
share of the mean over all frequencies, under the conditions: one symmetric linear system.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from controllers.errors import DesignError
from controllers.shapers.conditions import SOLVED, Condition, equations
from controllers.shapers.delays import DelayFilter

EVERYWHERE = 1e-3
"""Weight of the mean of |G|^2 over all frequencies against the mean over the band: keeps gains small without raising the band much."""


def quiet(conditions: Sequence[Condition], sample_period_s: float, transient_s: float, band_Hz: tuple[float, float]) -> DelayFilter:
    """Return the filter with taps at every sample from 0 to `transient_s`.

    Raises
    ------
    DesignError
        Fewer taps than equations, or an empty band.
    """
    check_band(band_Hz, sample_period_s)
    low, high = 2.0 * np.pi * band_Hz[0], 2.0 * np.pi * band_Hz[1]
    delays = sample_period_s * np.arange(round(transient_s / sample_period_s) + 1)
    matrix, right = equations(conditions, delays, None)
    if len(delays) < len(right):
        raise DesignError(
            f"a transient of {transient_s:.4g} s holds {len(delays)} taps, the conditions take {len(right)}: allow a longer transient"
        )
    apart = delays - delays[0]
    # mean of cos(w d) over the band, d the distance of two taps
    mean = (high * np.sinc(high * apart / np.pi) - low * np.sinc(low * apart / np.pi)) / (high - low)
    energy = scipy.linalg.toeplitz(mean) + EVERYWHERE * np.eye(len(delays))
    factor = scipy.linalg.cho_factor(energy)
    towards = scipy.linalg.cho_solve(factor, matrix.T)
    coupled = matrix @ towards
    gains = np.zeros(len(delays))
    for _ in range(4):  # the first pass solves, the others refine
        gains = gains + towards @ np.linalg.lstsq(coupled, right - matrix @ gains, rcond=1e-15)[0]
    missed = np.abs(right - matrix @ gains).max()
    if not missed <= SOLVED * max(1.0, np.abs(right).max()):
        raise DesignError(f"no quiet filter of {transient_s:.4g} s meets its conditions (residual {missed:.1e}): allow a longer transient")
    return DelayFilter(delays, gains, None, "hTDF quiet")


def check_band(band_Hz: tuple[float, float], sample_period_s: float) -> None:
    """Raise DesignError for a band that is empty or beyond half the sample rate."""
    low, high = band_Hz
    if not 0.0 <= low < high <= 0.5 / sample_period_s:
        raise DesignError(f"quiet band {low:g} to {high:g} Hz: takes 0 <= low < high <= {0.5 / sample_period_s:g} Hz")
