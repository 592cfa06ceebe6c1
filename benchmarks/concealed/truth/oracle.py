"""What somebody could tell who knows the true structure: how far an effect stands above noise once the machine file's numbers are
refitted, which other names could be told from it, what could be removed, and where it shows.

Everything is in units of the noise's standard deviation: signals are tapered, transformed, and whitened by the cross-spectral density of
what differs between repeats, so that other noise than that has a mean square of 1. A norm d is then the distance of two hypotheses in
standard deviations of the best linear test.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

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


INFLATION_SAMPLES, INFLATION_DRAWS = 128, 40
"""Length and number of the records that `inflation` draws."""


def taper_of(samples: int) -> np.ndarray:
    """(N,) of mean square 1."""
    taper = np.sin(np.pi * (np.arange(samples) + 0.5) / samples)
    return np.asarray(taper * np.sqrt(samples / np.sum(taper**2)))


def averaged_density(spectra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F, C, C) cross-spectral density of (R, F, C) spectra, averaged over neighbouring lines, and over how many (F,)."""
    repeats, count, channels = spectra.shape
    cross = np.einsum("rfi,rfj->fij", spectra, spectra.conj()) / repeats
    total = np.concatenate([np.zeros((1, channels, channels)), np.cumsum(cross, axis=0)])
    lines = np.arange(count)
    low, high = np.maximum(lines - LINES_AVERAGED, 1), np.minimum(lines + LINES_AVERAGED + 1, count)
    density = (total[high] - total[low]) / (high - low)[:, None, None]
    diagonal = np.einsum("fii->fi", density).real.copy()
    density *= 1.0 - SHRINKAGE
    density[:, np.arange(channels), np.arange(channels)] = diagonal + 1e-9
    return density, high - low


@cache
def inflation(repeats: int, channels: int) -> np.ndarray:
    """By how much other noise is more than 1, in squares, in units of a density that is averaged over so many lines: (lines + 1,).

    The inverse of a density of few degrees of freedom is too large in the mean, of a Wishart matrix by n / (n - C) (Anderson 2003, ch. 7);
    a taper's lines are not independent, so it is drawn. But for the shrinkage it is the same for every mixture of white channels.
    """
    random, taper = np.random.default_rng([repeats, channels]), taper_of(INFLATION_SAMPLES)
    squares, counts = np.zeros(2 * LINES_AVERAGED + 2), np.zeros(2 * LINES_AVERAGED + 2)
    for _ in range(INFLATION_DRAWS):
        known, other = random.standard_normal((2, repeats, INFLATION_SAMPLES, channels))
        spectra = [np.fft.rfft(noise * taper[:, None], axis=1) / np.sqrt(INFLATION_SAMPLES) for noise in (known, other)]
        density, averaged = averaged_density(spectra[0])
        white = np.einsum("fij,rfj->rfi", np.linalg.inv(np.linalg.cholesky(density)), spectra[1])
        of_lines = (np.abs(white) ** 2).mean(axis=(0, 2))[1:-1]  # a constant and the highest line have one real part
        np.add.at(squares, averaged[1:-1], of_lines)
        np.add.at(counts, averaged[1:-1], 1.0)
    known_for = np.flatnonzero(counts)
    return np.interp(np.arange(len(counts)), known_for, squares[known_for] / counts[known_for])


class NoiseUnits:
    """Whitening by what differs between repeats.

    Parameters
    ----------
    residuals : (R, N, C) array
        Recordings minus the truth's noise-free answer, of what a hidden lattice acts beside the answer without it.
    """

    def __init__(self, residuals: np.ndarray) -> None:
        repeats, samples, channels = residuals.shape
        self.repeats, self.samples = repeats, samples
        self.std = residuals.std(axis=(0, 1)) + 1e-300
        self.taper = taper_of(samples)
        spectra = np.fft.rfft((residuals - residuals.mean(axis=1, keepdims=True)) / self.std * self.taper[:, None], axis=1)
        density, averaged = averaged_density(spectra / np.sqrt(samples))
        self.density = np.einsum("fii->fi", density).real.copy()
        whitener = np.linalg.inv(np.linalg.cholesky(density))
        self._whitener = whitener / np.sqrt(inflation(repeats, channels))[averaged, None, None]

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
