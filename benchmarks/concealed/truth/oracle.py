"""What somebody could tell who knows the true structure: how far an effect stands above noise once the machine file's numbers are
refitted, which other names could be told from it, what could be removed, and where it shows.

Everything is in units of the noise's standard deviation: signals are tapered, transformed, and whitened by the cross-spectral density of
what differs between repeats. A norm d is then the distance of two hypotheses in standard deviations of the best linear test.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LINES_AVERAGED = 10
"""Frequencies to each side over which the noise's spectrum is averaged: 21 of them times the repeats are its degrees of freedom."""

SHRINKAGE = 0.02
"""Of the cross-spectra towards their diagonal: few degrees of freedom must not make a channel's noise look predictable from the others'."""

WINDOW_S = 0.25
"""Over which squares are averaged where a time is said to show the effect."""

POSITION_BINS = 24

NOTHING = 1e-9
"""Norm of a signal that counts as none, in deviations."""


class NoiseUnits:
    """Whitening by what differs between repeats.

    Parameters
    ----------
    residuals : (R, N, C) array
        Recordings minus the truth's noise-free answer.
    """

    def __init__(self, residuals: np.ndarray) -> None:
        repeats, samples, channels = residuals.shape
        self.repeats, self.samples = repeats, samples
        self.std = residuals.std(axis=(0, 1)) + 1e-300
        self.taper = np.sin(np.pi * (np.arange(samples) + 0.5) / samples)
        self.taper *= np.sqrt(samples / np.sum(self.taper**2))
        spectra = np.fft.rfft((residuals - residuals.mean(axis=1, keepdims=True)) / self.std * self.taper[:, None], axis=1)
        cross = np.einsum("rfi,rfj->fij", spectra, spectra.conj()) / (repeats * samples)
        total = np.concatenate([np.zeros((1, channels, channels)), np.cumsum(cross, axis=0)])
        lines = np.arange(len(cross))
        low, high = np.maximum(lines - LINES_AVERAGED, 1), np.minimum(lines + LINES_AVERAGED + 1, len(cross))
        density = (total[high] - total[low]) / (high - low)[:, None, None]
        diagonal = np.einsum("fii->fi", density).real.copy()
        density *= 1.0 - SHRINKAGE
        density[:, np.arange(channels), np.arange(channels)] = diagonal + 1e-9
        self.density = diagonal
        self._whitener = np.linalg.inv(np.linalg.cholesky(density))

    def __call__(self, signal: np.ndarray) -> np.ndarray:
        """(N, C) signal as a real vector whose norm is its distance from nothing, over all repeats."""
        lines = np.fft.rfft(signal / self.std * self.taper[:, None], axis=0) / np.sqrt(self.samples)
        white = np.einsum("fij,fj->fi", self._whitener, lines) * np.sqrt(2.0 * self.repeats)
        return np.concatenate([white.real.ravel(), white.imag.ravel()])


def coefficients(target: np.ndarray, columns: Sequence[np.ndarray]) -> np.ndarray:
    """Least-squares weights of the columns in the target; directions that the data do not tell get none."""
    if not columns:
        return np.zeros(0)
    table = np.column_stack(columns)
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0.0] = 1.0
    return np.linalg.lstsq(table / scale, target, rcond=1e-7)[0] / scale


def left_over(target: np.ndarray, columns: Sequence[np.ndarray]) -> float:
    """Norm of what the columns do not span."""
    if not columns:
        return float(np.linalg.norm(target))
    return float(np.linalg.norm(target - np.column_stack(columns) @ coefficients(target, columns)))


def location(
    effect: np.ndarray, units: NoiseUnits, rate_Hz: float, positions: np.ndarray, channels: list[str], axes: list[str]
) -> dict[str, object]:
    """Where the difference that an effect makes (N, C) exceeds one repeat's noise: channels' shares, times, frequencies, positions."""
    spectrum = np.abs(np.fft.rfft(effect / units.std * units.taper[:, None], axis=0)) ** 2 / units.samples
    power = (spectrum[1:] / units.density[1:]).sum(axis=0)
    shares = power / max(power.sum(), 1e-300)
    ratio = (effect / units.std) ** 2
    width = max(1, round(WINDOW_S * rate_Hz))
    smooth = np.apply_along_axis(lambda y: np.convolve(y, np.ones(width) / width, mode="same"), 0, ratio)
    in_time = (smooth > 1.0).any(axis=1)
    lines = np.apply_along_axis(lambda y: np.convolve(y, np.ones(5) / 5.0, mode="same"), 0, spectrum / units.density)
    in_frequency = (lines > 1.0).any(axis=1)
    frequency = np.fft.rfftfreq(units.samples, 1.0 / rate_Hz)
    where = {}
    for i, axis in enumerate(axes):
        edges = np.linspace(positions[:, i].min(), positions[:, i].max() + 1e-12, POSITION_BINS + 1)
        which = np.clip(np.digitize(positions[:, i], edges) - 1, 0, POSITION_BINS - 1)
        count = np.bincount(which, minlength=POSITION_BINS)
        mean = np.array([np.bincount(which, ratio[:, c], POSITION_BINS) / np.maximum(count, 1) for c in range(ratio.shape[1])])
        hit = (mean > 1.0).any(axis=0) & (count > 0)
        where[axis] = {"intervals": intervals(hit, edges[:-1], edges[1:]), "visited": [float(edges[0]), float(edges[-1])]}
    t = np.arange(units.samples) / rate_Hz
    return {
        "channels": {name: float(share) for name, share in zip(channels, shares, strict=True)},
        "time_s": intervals(in_time, t, t + 1.0 / rate_Hz),
        "frequency_hz": intervals(in_frequency, frequency - 0.5 * frequency[1], frequency + 0.5 * frequency[1]),
        "position": where,
    }


def intervals(mask: np.ndarray, starts: np.ndarray, ends: np.ndarray) -> list[list[float]]:
    """Runs of a mask as [start, end]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [[float(starts[a]), float(ends[b - 1])] for a, b in zip(edges[::2], edges[1::2], strict=True)]
