"""Discrete Fourier transforms of periodic records, scaled so that a line's value is the signal's Fourier coefficient.

The thesis scales by 1/sqrt(N), (3.3) and (4.4); frequency responses do not see the difference, and with 1/N the coefficient of an excited
line is the same over one period and over a whole record.
"""

from __future__ import annotations

import numpy as np
import scipy.fft


def period_spectra(samples: np.ndarray, period_samples: int) -> np.ndarray:
    """Return the spectrum of every period, (3.10).

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
    spectra: np.ndarray = scipy.fft.rfft(split, axis=-2, norm="forward")
    return spectra


def record_spectra(samples: np.ndarray, beyond: int = 0) -> np.ndarray:
    """Return the spectrum of whole records, (4.4), from bin -beyond to bin T // 2 + beyond.

    The DFT of real samples is periodic and conjugate symmetric, so that a local window is whole at 0 and at f_s / 2 too.

    Parameters
    ----------
    samples : (..., T, n)
    beyond : bins added at both ends.

    Returns
    -------
    (..., T // 2 + 1 + 2 beyond, n) complex; bin k is at index k + beyond.
    """
    T = samples.shape[-2]
    spectrum: np.ndarray = scipy.fft.rfft(samples, axis=-2, norm="forward")
    if beyond == 0:
        return spectrum
    below = np.conj(spectrum[..., beyond:0:-1, :])
    above = np.conj(spectrum[..., T - np.arange(T // 2 + 1, T // 2 + 1 + beyond), :])
    return np.concatenate((below, spectrum, above), axis=-2)
