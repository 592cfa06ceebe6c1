"""Cross-spectra between channels of records, behind filters that make each nearly white, and the roots of their inverses (`noise.py`)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import scipy.fft
import scipy.linalg

from hil.diagnosis.residuals.whitening_kernels import filter_and_weigh

FILTER_ORDER = 8
"""Of the autoregressive filter per channel: two resonances and two real poles."""

FREEDOM_PER_CHANNEL = 4
"""Complex degrees of freedom of S(f) per channel: fewer, and its inverse is dominated by what its sample happens to miss."""

RELATIVE_WIDTH = 0.05
"""S(f) is averaged over at least this share of the frequency, either side."""

LEAST_COHERENT = 1e-3
"""Floor of the eigenvalues of S(f) in units of its channels' own spectra: what one channel predicts of another is trusted to 3 %, because
loops and drives are known no better."""

FILL = 1e-4
"""White noise added per channel, as a share of its variance, when its autoregressive filter is fitted: bounds the filter's gain."""

NEAREST_LINES = 4
"""Lines per repeat from which the power of left-out repeats is taken, at least."""

LEFT_OUT_GRID = 100

LEAST_POWER = 0.5
"""Whitening is not made finer than this on the word of the left-out repeats."""

END_s = 0.5
"""At either end of a record, in which it fades and whitened rows are left out: as long as S(f)^(-1/2) with lines 2 Hz wide remembers."""

LARGEST_END = 0.05
"""As a share of the record."""

NEIGHBOURS = 10
"""Lines of the longest record on either side of a frequency, over which a channel's own density is averaged."""

GRID_LINES = 400
"""Frequencies on which S(f)^(-1/2) is kept, equally spaced on a scale that is linear below 1 Hz and logarithmic above."""


def filter_channels(filters: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Prediction errors (N - order, C) of every channel."""
    count = len(values) - (filters.shape[1] - 1)
    return np.ascontiguousarray(_filtered(filters, values.T, np.ones(count), count).T)


def _filtered(filters: np.ndarray, values: np.ndarray, weights: np.ndarray, length: int) -> np.ndarray:
    """(C, length) prediction errors (C, N - order) of values (C, N) times weights (N - order,), zeros behind."""
    filtered = np.zeros((len(filters), max(length, len(weights))))
    filter_and_weigh(filters, np.ascontiguousarray(values, dtype=float), weights, filtered)
    return filtered[:, :length]


def filtered_back(filters: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """(N, C), the adjoint of `filter_channels`: of errors (N - order, C)."""
    return np.column_stack([np.convolve(row[::-1], column) for row, column in zip(filters, errors.T, strict=True)])


def prediction_error_filter(rows: Sequence[np.ndarray], std: float) -> np.ndarray:
    """(FILTER_ORDER + 1,) filter that makes these series nearly white: Yule-Walker on their mean autocovariance."""
    total = sum(len(row) for row in rows)
    covariance = np.array([sum(float(row[lag:] @ row[: len(row) - lag]) for row in rows) / total for lag in range(FILTER_ORDER + 1)])
    covariance[0] += FILL * std**2
    weights = scipy.linalg.solve_toeplitz(covariance[:-1], covariance[1:])
    return np.concatenate(([1.0], -weights))


@lru_cache(maxsize=16)
def fading(count: int, longest: float) -> tuple[np.ndarray, int]:
    """Weights (count,) of mean square 1 that rise and fall along a quarter of a sine, and how many rows that takes."""
    end = min(round(longest), int(LARGEST_END * count))
    weights = np.ones(count)
    weights[:end] = np.sin(0.5 * np.pi * (np.arange(end) + 0.5) / max(end, 1))
    weights[count - end :] = weights[:end][::-1]
    return weights / np.sqrt(np.mean(weights**2)), end


def lines_of(filters: np.ndarray, values: np.ndarray, rate_Hz: float, end_s: float = END_s) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (K,) and lines (K, C) of the filtered channels of a record (N, C) that fades; white noise keeps its variance."""
    length = len(values) - (filters.shape[1] - 1)
    return np.fft.rfftfreq(length, 1.0 / rate_Hz), lines_by_channel(filters, values.T, rate_Hz, end_s, length).T


def lines_by_channel(filters: np.ndarray, values: np.ndarray, rate_Hz: float, end_s: float, length: int) -> np.ndarray:
    """(C, K) lines of `lines_of` from (C, N), of a transform of this length: where that is longer than the record zeros follow, and lines
    are as much closer, not independent of each other.
    """
    count = values.shape[1] - (filters.shape[1] - 1)
    faded = fading(count, end_s * rate_Hz)[0] / np.sqrt(count)
    return np.asarray(scipy.fft.rfft(_filtered(filters, values, faded, length)))


def lines_of_all(
    filters: np.ndarray, rows: Sequence[np.ndarray], rate_Hz: float, end_s: float = END_s
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Frequencies and lines of every record."""
    pairs = [lines_of(filters, row, rate_Hz, end_s) for row in rows]
    return [place for place, _ in pairs], [line for _, line in pairs]


def tapered_lines(values: np.ndarray) -> np.ndarray:
    """(K, C) lines of a record (N, C) that is tapered to nothing at its ends; white noise keeps its variance."""
    count = len(values)
    taper = np.sqrt(2.0 / count) * np.sin(np.pi * (np.arange(count) + 0.5) / count)
    return np.asarray(scipy.fft.rfft(values * taper[:, None], axis=0))


def density_of(rows: Sequence[np.ndarray], rate_Hz: float, grid: np.ndarray) -> np.ndarray:
    """(G, C) power of tapered records' lines, averaged over neighbours but for the constant: a record has one of those, too few to tell.

    What of it the taper lets into the first lines counts there, as it does in what they are compared with: repeats may differ by offsets.
    """
    place = np.concatenate([np.fft.rfftfreq(len(row), 1.0 / rate_Hz)[1:] for row in rows])
    power = np.concatenate([np.abs(tapered_lines(row)[1:]) ** 2 for row in rows])
    order = np.argsort(place, kind="stable")
    place, sums = place[order], np.vstack([np.zeros(power.shape[1]), np.cumsum(power[order], axis=0)])
    near = (NEIGHBOURS + 0.5) * rate_Hz / max(len(row) for row in rows)
    low, high = np.searchsorted(place, grid - near), np.searchsorted(place, grid + near)
    return np.asarray((sums[high] - sums[low]) / (high - low)[:, None])


def deviations_of(complete: np.ndarray) -> np.ndarray:
    """(R, N, C) deviations from the repeats' mean, scaled to one repeat's variance."""
    repeats = len(complete)
    return (complete - complete.mean(axis=0)) * np.sqrt(repeats / (repeats - 1.0))


def rms_of(rows: Sequence[np.ndarray], floor: np.ndarray) -> np.ndarray:
    """(C,) of records of any length, with the least noise that channels have."""
    return np.sqrt(sum((row**2).sum(axis=0) for row in rows) / sum(len(row) for row in rows) + floor**2)


def grid_of(rate_Hz: float, rows: int) -> np.ndarray:
    """(G,) frequencies up to half the rate: GRID_LINES, or fewer where records are short."""
    nyquist = 0.5 * rate_Hz
    scale = np.arcsinh(nyquist)
    return np.sinh(np.linspace(0.0, scale, min(GRID_LINES, max(rows // 4, 8))))


def gains_of(filters: np.ndarray, grid: np.ndarray, rate_Hz: float) -> np.ndarray:
    """(G, C) power of white noise of variance 1 behind the channels' filters."""
    z = np.exp(-2j * np.pi * np.outer(grid / rate_Hz, np.arange(filters.shape[1])))
    return np.abs(z @ filters.T) ** 2


def smoothed(
    lines: Sequence[np.ndarray], frequencies: Sequence[np.ndarray], grid: np.ndarray, free: float, wanted: float
) -> tuple[np.ndarray, np.ndarray]:
    """S (G, C, C) on the grid and its complex degrees of freedom (G,): neighbours until there are enough of them."""
    place = np.concatenate(frequencies)
    order = np.argsort(place, kind="stable")
    place, line = place[order], np.concatenate(lines)[order]
    count = line.shape[1]
    sums = np.zeros((len(place) + 1, count, count), dtype=complex)
    np.cumsum(line[:, :, None] * line[:, None, :].conj(), axis=0, out=sums[1:])
    needed = min(int(np.ceil(wanted / free)), len(place))
    spectra = np.zeros((len(grid), count, count), dtype=complex)
    freedom = np.zeros(len(grid))
    for g, f in enumerate(grid):
        low, high = np.searchsorted(place, [f * (1.0 - RELATIVE_WIDTH), f * (1.0 + RELATIVE_WIDTH)])
        short = needed - (high - low)
        if short > 0:
            low = max(0, low - (short + 1) // 2)
            high = min(len(place), low + needed)
            low = max(0, high - needed)
        s = (sums[high] - sums[low]) / (high - low)
        spectra[g] = s.real if f == 0.0 else s
        freedom[g] = (high - low) * free
    return spectra, freedom


def spectra_of_common(filters: np.ndarray, rows: Sequence[np.ndarray], rate_Hz: float, grid: np.ndarray) -> np.ndarray:
    """S (G, C, C) on the grid of records that stand for themselves, not for deviations from a mean."""
    frequencies, lines = lines_of_all(filters, rows, rate_Hz)
    return smoothed(lines, frequencies, grid, 1.0, FREEDOM_PER_CHANNEL * len(filters))[0]


def whitening(spectra: np.ndarray, freedom: np.ndarray, floors: np.ndarray) -> np.ndarray:
    """(G, C, C) S^(-1/2), scaled so that its square's mean is the inverse covariance: that of a sample covariance is too large."""
    count = floors.shape[1]
    roots = np.stack([inverse_root(s + np.diag(floor)) for s, floor in zip(spectra, floors, strict=True)])
    return roots * np.sqrt(np.clip((freedom - count) / freedom, 0.1, 1.0))[:, None, None]


def inverse_root(s: np.ndarray) -> np.ndarray:
    """Hermitian S^(-1/2), its eigenvalues bounded from below in units of the channels' own spectra."""
    own = np.sqrt(np.diag(s).real)
    value, vector = np.linalg.eigh(s / own[:, None] / own[None, :])
    value = np.maximum(value, LEAST_COHERENT)
    return (vector / np.sqrt(value)) @ vector.conj().T / own[None, :]


def power_of_left_out(
    deviations: Sequence[np.ndarray], filters: np.ndarray, floors: np.ndarray, rate_Hz: float, grid: np.ndarray
) -> np.ndarray | None:
    """(G, C) power of every repeat, whitened with the others' S: 1 where the averaged S holds; None where no group has three repeats.

    An average over neighbours is wrong where a spectrum is steep or made of lines; a repeat that had no part in it shows by how much.
    """
    count = len(filters)
    whitened, places = [], []
    for rows in deviations:
        repeats = len(rows)
        if repeats < 3:
            continue
        (place, *_), found = lines_of_all(filters, list(rows), rate_Hz)
        lines = np.stack(found)
        for left_out in range(repeats):
            others = np.delete(lines, left_out, axis=0) + lines[left_out] / (repeats - 1.0)  # about their own mean
            others *= np.sqrt((repeats - 1.0) / repeats * (repeats - 1.0) / (repeats - 2.0))
            free = (repeats - 2.0) / (repeats - 1.0)
            every = max(1, len(grid) // LEFT_OUT_GRID)
            coarse = grid[::every]
            spectra, freedom = smoothed(list(others), [place] * (repeats - 1), coarse, free, FREEDOM_PER_CHANNEL * count)
            roots = whitening(spectra, freedom, floors[::every])
            nearest = np.rint(np.interp(place, coarse, np.arange(len(coarse)))).astype(int)
            whitened.append((roots[nearest] @ lines[left_out][:, :, None])[:, :, 0])
            places.append(place)
    if not whitened:
        return None
    return np.maximum(_mean_power(whitened, places, grid), LEAST_POWER)


def power_of(roots: np.ndarray, grid: np.ndarray, lines: Sequence[np.ndarray], frequencies: Sequence[np.ndarray]) -> np.ndarray:
    """(G, C) power of whitened lines near every grid frequency."""
    whitened = []
    for line, place in zip(lines, frequencies, strict=True):
        nearest = np.rint(np.interp(place, grid, np.arange(len(grid)))).astype(int)
        whitened.append((roots[nearest] @ line[:, :, None])[:, :, 0])
    return _mean_power(whitened, frequencies, grid)


def _mean_power(whitened: Sequence[np.ndarray], frequencies: Sequence[np.ndarray], grid: np.ndarray) -> np.ndarray:
    """(G, C) mean square of lines near every grid frequency: of the nearest few where the spectrum may be steep, of more further up."""
    place = np.concatenate(frequencies)
    order = np.argsort(place, kind="stable")
    place, power = place[order], np.abs(np.concatenate(whitened)[order]) ** 2
    sums = np.vstack([np.zeros(power.shape[1]), np.cumsum(power, axis=0)])
    least = len(frequencies) * NEAREST_LINES
    found = np.ones((len(grid), power.shape[1]))
    for g, f in enumerate(grid):
        low, high = np.searchsorted(place, [f * (1.0 - RELATIVE_WIDTH), f * (1.0 + RELATIVE_WIDTH)])
        if high - low < least:
            low = int(np.clip(np.searchsorted(place, f) - least // 2, 0, max(0, len(place) - least)))
            high = min(low + least, len(place))
        found[g] = (sums[high] - sums[low]) / (high - low)
    return found
