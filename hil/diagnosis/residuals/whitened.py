"""Residuals in units of repeat noise, channel by channel, over time and over frequency: what locations and heat maps are made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hil.diagnosis.residuals.noise import NoiseModel
from hil.diagnosis.residuals.spectra import filter_channels, tapered_lines


@dataclass(frozen=True, eq=False)
class InNoiseUnits:
    """A signal (N, C) divided by each channel's own noise spectrum: 1 is as large as one repeat's noise. Over time that is the noise
    model's, behind its filters; over frequency the density of the repeats' own lines, which is right at the lowest of them too.

    Attributes
    ----------
    rows : (M, C) array
        Over time; the first rows of the record are lost to the noise model's filter.
    first_row : int
        Row of the record that `rows` begins with.
    frequencies_Hz : (K,) array
    power : (K, C) array
        Over frequency, of the record tapered at its ends; 1 is the noise's.
    """

    rows: np.ndarray
    first_row: int
    frequencies_Hz: np.ndarray
    power: np.ndarray


def in_noise_units(noise: NoiseModel, signal: np.ndarray) -> InNoiseUnits:
    """Whiten every channel by its own spectrum, whatever the others do.

    Parameters
    ----------
    noise : NoiseModel
    signal : (N, C) array
        In the channels' units, complete.
    """
    filtered = filter_channels(noise.filters, signal)
    count = len(filtered)
    lines = np.fft.rfft(filtered, axis=0) / (np.sqrt(count) * _rms_of_lines(noise, count))
    rows = np.fft.irfft(lines * np.sqrt(count), count, axis=0)
    frequencies = np.fft.rfftfreq(len(signal), 1.0 / noise.rate_Hz)
    power = np.abs(tapered_lines(signal)) ** 2 / _at(frequencies, noise.grid_Hz, noise.density)
    return InNoiseUnits(rows, len(signal) - count, frequencies, power)


@lru_cache(maxsize=16)
def _rms_of_lines(noise: NoiseModel, count: int) -> np.ndarray:
    """(K, C) noise rms of the filtered channels' lines."""
    return _at(np.fft.rfftfreq(count, 1.0 / noise.rate_Hz), noise.grid_Hz, noise.own)


def white_in_noise_units(noise: NoiseModel, std: np.ndarray, frequencies_Hz: np.ndarray) -> np.ndarray:
    """(K, C) power over frequency of white noise of this rms (C,) in the channels' units."""
    return np.asarray(std**2 / _at(frequencies_Hz, noise.grid_Hz, noise.density))


def _at(frequencies_Hz: np.ndarray, grid_Hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(K, C) values (G, C) of the grid at these frequencies."""
    return np.column_stack([np.interp(frequencies_Hz, grid_Hz, column) for column in values.T])
