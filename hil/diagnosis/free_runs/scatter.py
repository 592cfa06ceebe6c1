"""What repeats of an experiment scatter by, over frequency and across channels."""

from __future__ import annotations

import numpy as np
import scipy.signal

from hil.diagnosis.retuning.bounded import ROUNDING

LINES = 10
"""Of a spectrum, on either side of each, over which the scatter is averaged; as many as there are channels at least."""
TAPER = 0.05
"""Share of the rows at either end over which what is compared fades: a record ends where a spectrum goes round."""


class Scatter:
    """Covariance of repeats about their mean: by it a misfit of the mean becomes white, of unit variance where it is noise.

    Parameters
    ----------
    deviations : (R, N, C) array
        What every repeat differs from the mean by.
    alike : (N, C) array
        An error that all repeats have alike, such as what lattices make of a run.
    """

    def __init__(self, deviations: np.ndarray, alike: np.ndarray) -> None:
        repeats, rows, channels = deviations.shape
        self._window = scipy.signal.windows.tukey(rows, 2.0 * TAPER)[:, None]
        common = np.sqrt(repeats) * np.fft.rfft(alike * self._window, axis=0)
        spectra = np.fft.rfft(deviations * self._window, axis=1) / np.sqrt(repeats - 1)
        spectra = np.concatenate([spectra, common[None]])
        aside = min(max(LINES, channels), (spectra.shape[1] - 1) // 2)
        scale = np.sqrt(_smooth(np.sum(np.abs(spectra) ** 2, axis=0), aside))
        spectra = spectra / scale
        each = np.einsum("rkc,rkd->kcd", spectra, spectra.conj())
        first = _windows(len(each), aside)[:, 0]
        sums = np.concatenate([np.zeros((1, channels, channels)), np.cumsum(each, axis=0)])
        covariance = (sums[first + 2 * aside + 1] - sums[first]) / (2 * aside + 1)
        freedom = (2.0 * aside + 1.0) * (repeats - 1.0)
        unbiased = np.sqrt(max(freedom - channels, 1.0) / freedom)  # of an inverse that was estimated (Goodman 1963)
        roots = np.linalg.inv(np.linalg.cholesky(covariance + ROUNDING * np.eye(channels)))
        self._roots = np.sqrt(repeats) * unbiased * roots / scale[:, None, :]

    def whiten(self, misfit: np.ndarray) -> np.ndarray:
        """Return misfits (..., N, C) of the mean as (..., N C) white values."""
        *several, rows, channels = misfit.shape
        spectra = np.fft.rfft((misfit * self._window).reshape(-1, rows, channels), axis=1)
        white = np.fft.irfft(np.einsum("kcd,tkd->tkc", self._roots, spectra, optimize=True), rows, axis=1)
        return np.asarray(np.sqrt(rows) * white).reshape(*several, rows * channels)


def _windows(lines: int, aside: int) -> np.ndarray:
    """Return the lines (K, 2 aside + 1) beside each one, and itself."""
    first = np.clip(np.arange(lines) - aside, 0, lines - 1 - 2 * aside)
    return np.asarray(first[:, None] + np.arange(2 * aside + 1))


def _smooth(power: np.ndarray, aside: int) -> np.ndarray:
    """Return a power (K, C) smoothed as what is straight, nearby, in logarithms of both power and frequency: slow noise is steep."""
    windows = _windows(len(power), aside)
    x = np.log(np.arange(len(power)) + 0.5)
    y = np.log(np.maximum(power, 1e-300))
    at, values = x[windows], y[windows]
    middle, level = at.mean(axis=1), values.mean(axis=1)
    away = at - middle[:, None]
    slope = np.einsum("kw,kwc->kc", away, values) / np.sum(away**2, axis=1)[:, None]
    smooth: np.ndarray = np.exp(level + slope * (x - middle)[:, None])
    return smooth
