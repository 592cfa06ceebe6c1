"""Noise of a machine, per channel and frequency and between channels, from what repeats do not have in common.

In closed loop a disturbance moves current, encoder and IMU together, and it is coloured. The deviations of repeats from their mean, IMU
channels less what encoders say of them (`carried.py`), are made nearly white per channel (an autoregressive filter), their cross-spectral
matrix S(f) between channels is averaged over neighbouring frequencies, and residuals are whitened with S(f)^(-1/2).
A filter that is a function of frequency goes around a record: what comes next after its last row would be its first. So the record fades in
and out, and the whitened rows of these ends are left out.
Pintelon and Schoukens 2012, ch. 2.5 and 4.3 (sample covariances of repeats); Kay 1988, ch. 7 (autoregressive spectra); Percival and Walden
1993, ch. 6 (tapers, prewhitening).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg
import scipy.signal

from hil.diagnosis.carried import CarriedImu
from hil.diagnosis.result import NoiseKind
from hil.errors import RecordingError
from hil.machine import Machine

if TYPE_CHECKING:
    from hil.diagnosis.mismatch import RepeatGroup

FILTER_ORDER = 8
"""Of the autoregressive filter per channel: two resonances and two real poles."""

FREEDOM_PER_CHANNEL = 4
"""Complex degrees of freedom of S(f) per channel: fewer, and its inverse is dominated by what its sample happens to miss."""

RELATIVE_WIDTH = 0.05
"""S(f) is averaged over at least this share of the frequency, either side."""

LEAST_COHERENT = 1e-3
"""Floor of the eigenvalues of S(f) in units of its channels' own spectra: what one channel predicts of another is trusted to 3 %, because
loops and drives are known no better."""

NO_FLOOR = 1e-12
"""Least noise of a channel without a resolution, in its unit."""

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

GRID_LINES = 400
"""Frequencies on which S(f)^(-1/2) is kept, equally spaced on a scale that is linear below 1 Hz and logarithmic above."""


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Second moments of one repeat's noise.

    Attributes
    ----------
    kind : "repeats", "periods" or "assumed"
    std : (C,) array
        Noise rms per channel, its units.
    rate_Hz : float
    filters : (C, FILTER_ORDER + 1) array
        Prediction-error filter of each channel.
    grid_Hz : (G,) array
    roots : (G, C, C) complex array
        S^(-1/2) of the filtered channels at the grid's frequencies.
    own : (G, C) array
        Rms of the filtered channels' lines, each by itself, with all that moves it.
    freedom : float
        Least complex degrees of freedom any S was averaged over.
    end_s : float
        At either end of a record, in which it fades and whitened rows are left out.
    shared : (G, C, C) complex array, optional
        S of the filtered channels of what repeats have in common, besides what they do not: a mean of them keeps it. See `of_mean`.
    """

    kind: NoiseKind
    std: np.ndarray
    rate_Hz: float
    filters: np.ndarray
    grid_Hz: np.ndarray
    roots: np.ndarray
    own: np.ndarray
    freedom: float
    end_s: float
    shared: np.ndarray | None = None

    def of_mean(self, repeats: int) -> NoiseModel:
        """The noise of a mean of so many repeats, in units of one's: times sqrt(repeats). The same where repeats have nothing in common."""
        return self if self.shared is None else _of_mean(self, repeats)

    def spectrum(self, values: np.ndarray, imu: CarriedImu | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Whitened lines of a record that fades in and out.

        Parameters
        ----------
        values : (N, C) array
            In the channels' units, complete.
        imu : CarriedImu, optional
            What the encoders say of the IMU along this record's motion.

        Returns
        -------
        frequencies_Hz : (K,) array
        lines : (K, C) complex array
            Of mean square 1 for one repeat's noise; entry c stands mostly for channel c.
        """
        if imu is not None and self.kind != "assumed":
            values = imu.without(values)
        frequencies, lines = _lines(self.filters, values, self.rate_Hz, self.end_s)
        return frequencies, (_roots_of(self, len(values)) @ lines[:, :, None])[:, :, 0]

    def whiten(self, values: np.ndarray, imu: CarriedImu | None = None) -> np.ndarray:
        """(M,) numbers of unit variance for one repeat's noise, from (N, C) in the channels' units. Linear in `values`.

        They are rows of C, in time, without those in which the record fades.
        """
        _, lines = self.spectrum(values, imu)
        count = len(values) - FILTER_ORDER
        fade, end = _fade(count, self.end_s * self.rate_Hz)
        rows = np.fft.irfft(lines, count, axis=0) * (np.sqrt(count) / fade.max())
        return rows[end : count - end].ravel()

    def size(self, rows: int) -> int:
        """How many numbers `whiten` makes of this many rows."""
        count = rows - FILTER_ORDER
        return (count - 2 * _fade(count, self.end_s * self.rate_Hz)[1]) * len(self.std)

    def backwards(self, whitened: np.ndarray) -> np.ndarray:
        """`whiten`'s numbers (M,) with the record run backwards."""
        return np.ascontiguousarray(whitened.reshape(-1, len(self.std))[::-1]).ravel()


@lru_cache(maxsize=16)
def _of_mean(noise: NoiseModel, repeats: int) -> NoiseModel:
    assert noise.shared is not None
    inverse = np.linalg.inv(noise.roots)
    own = inverse @ np.conj(np.swapaxes(inverse, 1, 2))
    roots = np.stack([_inverse_root(s) for s in own + repeats * noise.shared])
    return replace(noise, roots=roots, shared=None)


@lru_cache(maxsize=16)
def _roots_of(noise: NoiseModel, rows: int) -> np.ndarray:
    """(K, C, C) S^(-1/2) at the lines of a record of this many rows, linear between the grid's neighbours."""
    frequencies = np.fft.rfftfreq(rows - FILTER_ORDER, 1.0 / noise.rate_Hz)
    place = np.clip(np.interp(frequencies, noise.grid_Hz, np.arange(len(noise.grid_Hz))), 0.0, len(noise.grid_Hz) - 1.000001)
    low = place.astype(int)
    share = (place - low)[:, None, None]
    return (1.0 - share) * noise.roots[low] + share * noise.roots[low + 1]


@lru_cache(maxsize=16)
def _fade(count: int, longest: float) -> tuple[np.ndarray, int]:
    """Weights (count,) of mean square 1 that rise and fall along a quarter of a sine, and how many rows that takes."""
    end = min(round(longest), int(LARGEST_END * count))
    weights = np.ones(count)
    weights[:end] = np.sin(0.5 * np.pi * (np.arange(end) + 0.5) / max(end, 1))
    weights[count - end :] = weights[:end][::-1]
    return weights / np.sqrt(np.mean(weights**2)), end


def _lines(filters: np.ndarray, values: np.ndarray, rate_Hz: float, end_s: float = END_s) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (K,) and lines (K, C) of the filtered channels of a record (N, C) that fades; white noise keeps its variance."""
    filtered = filter_channels(filters, values)
    count = len(filtered)
    lines = np.fft.rfft(filtered * _fade(count, end_s * rate_Hz)[0][:, None], axis=0) / np.sqrt(count)
    return np.fft.rfftfreq(count, 1.0 / rate_Hz), lines


def filter_channels(filters: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Prediction errors (N - order, C) of every channel."""
    order = filters.shape[1] - 1
    return np.column_stack([scipy.signal.lfilter(row, [1.0], column)[order:] for row, column in zip(filters, values.T, strict=True)])


def noise_model(
    groups: Sequence[RepeatGroup],
    channels: Sequence[str],
    machine: Machine,
    shared: Sequence[tuple[RepeatGroup, np.ndarray]] = (),
) -> NoiseModel:
    """Noise from all groups that have repeats; else bounded from the residual and `assumed`.

    Parameters
    ----------
    groups : sequence of RepeatGroup
    channels : sequence of str
    machine : Machine
        Its sensors' noise and resolution are the least a channel has.
    shared : sequence of (RepeatGroup, (N, C) array), optional
        Records of what all repeats of a group have in common and simulations lack (`loop_lattices.py`).

    Raises
    ------
    RecordingError
        Repeats that are copies of one recording.
    """
    repeated = [group for group in groups if group.repeats > 1]
    if not repeated:
        return assumed_noise([group.mean - group.simulated for group in groups], channels, machine)
    kind: NoiseKind = "repeats" if any(len(group.windows) == 1 for group in repeated) else "periods"
    recorded = [_deviations(group.complete) for group in repeated]
    deviations = [rows if group.imu is None else group.imu.without(rows) for group, rows in zip(repeated, recorded, strict=True)]
    floor = sensor_floor(channels, machine)
    if all(np.all(group.complete == group.complete[0]) for group in repeated) and np.any(floor <= NO_FLOOR):
        same = ", ".join(label for group in repeated for label in group.labels)
        raise RecordingError(
            f"{same}: the same to the last digit; repeats of an experiment differ by its noise: give recordings, not copies of one"
        )
    std = _rms([row for group in recorded for row in group], floor)
    rows = [row for group in deviations for row in group]
    common = [each for _, each in shared]
    uncarried = [each if group.imu is None else group.imu.without(each) for group, each in shared]
    left = _rms(rows + uncarried, floor)
    filters = np.stack([_prediction_error_filter([row[:, c] for row in rows + uncarried], left[c]) for c in range(len(channels))])
    rate_Hz = machine.sample_rate_Hz
    frequencies, lines = _lines_of_all(filters, rows, rate_Hz)
    # the mean was taken from the same repeats: R - 1 of R deviations are free, and their scale says so already
    free = sum(group.repeats - 1 for group in repeated) / sum(group.repeats for group in repeated)
    grid = _grid(rate_Hz, max(len(row) for row in rows))
    spectra, freedom = _smoothed(lines, frequencies, grid, free, FREEDOM_PER_CHANNEL * len(channels))
    floors = floor**2 * _gains(filters, grid, rate_Hz)
    roots = _whitening(spectra, freedom, floors)
    power = _power_of_left_out(deviations, filters, floors, rate_Hz, grid)
    if power is None:
        power = np.maximum(_power(roots, grid, lines, frequencies), 1.0)
    _, with_carried = _lines_of_all(filters, [row for group in recorded for row in group], rate_Hz)
    whole, _ = _smoothed(with_carried, frequencies, grid, free, FREEDOM_PER_CHANNEL * len(channels))
    own = np.diagonal(whole, axis1=1, axis2=2).real + floors
    roots = roots / np.sqrt(power)[:, :, None]
    between = None
    if shared:
        std = np.hypot(std, _rms(common, np.zeros_like(floor)))
        own = own + np.diagonal(_spectra_of_common(filters, common, rate_Hz, grid), axis1=1, axis2=2).real
        between = _spectra_of_common(filters, uncarried, rate_Hz, grid)
    return NoiseModel(kind, std, rate_Hz, filters, grid, roots, np.sqrt(own), float(freedom.min()), END_s, between)


def _spectra_of_common(filters: np.ndarray, rows: Sequence[np.ndarray], rate_Hz: float, grid: np.ndarray) -> np.ndarray:
    """S (G, C, C) on the grid of records that stand for themselves, not for deviations from a mean."""
    frequencies, lines = _lines_of_all(filters, rows, rate_Hz)
    return _smoothed(lines, frequencies, grid, 1.0, FREEDOM_PER_CHANNEL * len(filters))[0]


def _rms(rows: Sequence[np.ndarray], floor: np.ndarray) -> np.ndarray:
    """(C,) of records of any length, with the least noise that channels have."""
    return np.sqrt(sum((row**2).sum(axis=0) for row in rows) / sum(len(row) for row in rows) + floor**2)


def _lines_of_all(
    filters: np.ndarray, rows: Sequence[np.ndarray], rate_Hz: float, end_s: float = END_s
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Frequencies and lines of every record."""
    pairs = [_lines(filters, row, rate_Hz, end_s) for row in rows]
    return [place for place, _ in pairs], [line for _, line in pairs]


def assumed_noise(residuals: Sequence[np.ndarray], channels: Sequence[str], machine: Machine) -> NoiseModel:
    """Noise of single recordings, bounded per channel by what is left of the residual between its strong lines, and taken for white.

    The median of neighbouring lines' power, and of that over octaves, stands for the noise: mismatch that is concentrated in frequency
    does not raise it. Nothing tells a slow disturbance from a slow mismatch in a single recording: noise of the residual's own colour would
    leave only the mismatch's edges visible (on `emps`, Coulomb friction's reversals without its plateaus).
    """
    floor = sensor_floor(channels, machine)
    rate_Hz = machine.sample_rate_Hz
    count = len(channels)
    std = _rms(residuals, floor)
    filters = np.stack([_prediction_error_filter([row[:, c] for row in residuals], std[c]) for c in range(count)])
    grid = _grid(rate_Hz, max(len(row) for row in residuals))
    places, lines = _lines_of_all(filters, residuals, rate_Hz, 0.0)
    power, place = np.abs(np.concatenate(lines)) ** 2, np.concatenate(places)
    spacing = rate_Hz / max(len(row) for row in residuals)
    gains = _gains(filters, grid, rate_Hz)
    levels = np.zeros((len(grid), count))
    for g, f in enumerate(grid):
        near = np.abs(place - f) <= max(10.5 * spacing, 0.3 * f)
        levels[g] = np.median(power[near], axis=0) / np.log(2.0) + floor**2 * gains[g]  # of an exponential distribution, ln 2 of the mean
    white = np.minimum(np.median(levels / gains, axis=0), std**2)
    roots = np.zeros((len(grid), count, count), dtype=complex)
    own = np.sqrt(white * gains)
    roots[:, np.arange(count), np.arange(count)] = 1.0 / own
    return NoiseModel("assumed", np.sqrt(white), rate_Hz, filters, grid, roots, own, np.inf, 0.0)


def sensor_floor(channels: Sequence[str], machine: Machine) -> np.ndarray:
    """(C,) least noise rms of every channel: rounding of its lattice."""
    least: dict[str, float] = {}
    for encoder in machine.plant.encoders:
        least[encoder.channel] = encoder.resolution
    for current in machine.plant.currents:
        least[current.channel] = current.resolution
    for imu in machine.plant.imus:
        for letter in "xyz":
            least[f"imu_{letter}"] = imu.accelerometer_resolution_m_s2
            least[f"gyro_{letter}"] = imu.gyro_resolution_rad_s
    for drive in machine.plant.drives:
        least[f"command_{drive.axis}"] = drive.resolution
    rounding = np.array([least.get(name, 0.0) for name in channels]) / np.sqrt(12.0)
    return np.where(rounding > 0.0, rounding, NO_FLOOR)


def _deviations(complete: np.ndarray) -> np.ndarray:
    """(R, N, C) deviations from the repeats' mean, scaled to one repeat's variance."""
    repeats = len(complete)
    return (complete - complete.mean(axis=0)) * np.sqrt(repeats / (repeats - 1.0))


def _prediction_error_filter(rows: Sequence[np.ndarray], std: float) -> np.ndarray:
    """(FILTER_ORDER + 1,) filter that makes these series nearly white: Yule-Walker on their mean autocovariance."""
    total = sum(len(row) for row in rows)
    covariance = np.array([sum(float(row[lag:] @ row[: len(row) - lag]) for row in rows) / total for lag in range(FILTER_ORDER + 1)])
    covariance[0] += FILL * std**2
    weights = scipy.linalg.solve_toeplitz(covariance[:-1], covariance[1:])
    return np.concatenate(([1.0], -weights))


def _grid(rate_Hz: float, rows: int) -> np.ndarray:
    nyquist = 0.5 * rate_Hz
    scale = np.arcsinh(nyquist)
    return np.sinh(np.linspace(0.0, scale, min(GRID_LINES, max(rows // 4, 8))))


def _smoothed(
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


def _gains(filters: np.ndarray, grid: np.ndarray, rate_Hz: float) -> np.ndarray:
    """(G, C) power of white noise of variance 1 behind the channels' filters."""
    z = np.exp(-2j * np.pi * np.outer(grid / rate_Hz, np.arange(filters.shape[1])))
    return np.abs(z @ filters.T) ** 2


def _whitening(spectra: np.ndarray, freedom: np.ndarray, floors: np.ndarray) -> np.ndarray:
    """(G, C, C) S^(-1/2), scaled so that its square's mean is the inverse covariance: that of a sample covariance is too large."""
    count = floors.shape[1]
    roots = np.stack([_inverse_root(s + np.diag(floor)) for s, floor in zip(spectra, floors, strict=True)])
    return roots * np.sqrt(np.clip((freedom - count) / freedom, 0.1, 1.0))[:, None, None]


def _power_of_left_out(
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
        (place, *_), found = _lines_of_all(filters, list(rows), rate_Hz)
        lines = np.stack(found)
        for left_out in range(repeats):
            others = np.delete(lines, left_out, axis=0) + lines[left_out] / (repeats - 1.0)  # about their own mean
            others *= np.sqrt((repeats - 1.0) / repeats * (repeats - 1.0) / (repeats - 2.0))
            free = (repeats - 2.0) / (repeats - 1.0)
            every = max(1, len(grid) // LEFT_OUT_GRID)
            coarse = grid[::every]
            spectra, freedom = _smoothed(list(others), [place] * (repeats - 1), coarse, free, FREEDOM_PER_CHANNEL * count)
            roots = _whitening(spectra, freedom, floors[::every])
            nearest = np.rint(np.interp(place, coarse, np.arange(len(coarse)))).astype(int)
            whitened.append((roots[nearest] @ lines[left_out][:, :, None])[:, :, 0])
            places.append(place)
    if not whitened:
        return None
    return np.maximum(_mean_power(whitened, places, grid), LEAST_POWER)


def _power(roots: np.ndarray, grid: np.ndarray, lines: Sequence[np.ndarray], frequencies: Sequence[np.ndarray]) -> np.ndarray:
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


def _inverse_root(s: np.ndarray) -> np.ndarray:
    """Hermitian S^(-1/2), its eigenvalues bounded from below in units of the channels' own spectra."""
    own = np.sqrt(np.diag(s).real)
    value, vector = np.linalg.eigh(s / own[:, None] / own[None, :])
    value = np.maximum(value, LEAST_COHERENT)
    return (vector / np.sqrt(value)) @ vector.conj().T / own[None, :]
