"""Discrete Fourier transforms of periodic records, scaled so that a line's value is the signal's Fourier coefficient.

The thesis scales by 1/sqrt(N), (3.3) and (4.4); frequency responses do not see the difference, and with 1/N the coefficient of an excited
line is the same over one period and over a whole record.
"""

from __future__ import annotations

import numpy as np
import scipy.fft


def period_spectra(samples: np.ndarray, period_samples: int) -> np.ndarray:
    """Spectrum of every period, (3.10).

    Parameters
    ----------
    samples : (..., P N, n) whole periods.
    period_samples : N.

    Returns
    -------
    (..., P, N // 2 + 1, n) complex.
    """
    *leading, total, channels = samples.shape
    split = samples.reshape(*leading, total // period_samples, period_samples, channels)
    return scipy.fft.rfft(split, axis=-2) / period_samples


def record_spectra(samples: np.ndarray) -> np.ndarray:
    """Spectrum of whole records, (4.4): (..., T, n) real to (..., T, n) complex, negative frequencies in the upper half of the bins."""
    return scipy.fft.fft(samples, axis=-2) / samples.shape[-2]
