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

import numpy as np
import scipy.fft

from hil.diagnosis.residuals.carried import CarriedImu
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.residuals.spectra import (
    FILTER_ORDER,
    FREEDOM_PER_CHANNEL,
    END_s,
    density_of,
    deviations_of,
    fading,
    filtered_back,
    gains_of,
    grid_of,
    inverse_root,
    lines_by_channel,
    lines_of_all,
    power_of,
    power_of_left_out,
    prediction_error_filter,
    rms_of,
    smoothed,
    spectra_of_common,
    whitening,
)
from hil.diagnosis.residuals.whitening_kernels import mix_channels
from hil.diagnosis.result import NoiseKind
from hil.errors import RecordingError
from hil.machine import Machine

NO_FLOOR = 1e-12
"""Least noise of a channel without a resolution, in its unit."""


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
    density : (G, C) array
        Power of the channels' own lines, not filtered: what mismatches are compared with over frequency.
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
    density: np.ndarray
    freedom: float
    end_s: float
    shared: np.ndarray | None = None

    def of_mean(self, repeats: int) -> NoiseModel:
        """The noise of a mean of so many repeats, in units of one's: times sqrt(repeats). The same where repeats have nothing in common."""
        return self if self.shared is None else _of_mean(self, repeats)

    def spectrum(self, values: np.ndarray, imu: CarriedImu | None = None, length: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Whitened lines of a record that fades in and out.

        Parameters
        ----------
        values : (N, C) array
            In the channels' units, complete.
        imu : CarriedImu, optional
            What the encoders say of the IMU along this record's motion.
        length : int, optional
            Rows of the transform, zeros behind the record; as many as it has by default.

        Returns
        -------
        frequencies_Hz : (K,) array
        lines : (K, C) complex array
            Of mean square 1 for one repeat's noise; entry c stands mostly for channel c.
        """
        length = len(values) - FILTER_ORDER if length is None else length
        return np.fft.rfftfreq(length, 1.0 / self.rate_Hz), self._lines(values, imu, length)

    def _lines(self, values: np.ndarray, imu: CarriedImu | None, length: int) -> np.ndarray:
        """(K, C) of `spectrum`."""
        by_channel = values.T if imu is None or self.kind == "assumed" else imu.without_by_channel(values)
        lines = lines_by_channel(self.filters, by_channel, self.rate_Hz, self.end_s, length)
        mixed = np.empty(lines.shape[::-1], dtype=complex)
        mix_channels(_roots_of(self, length), np.ascontiguousarray(lines.T), mixed)
        return mixed

    def whiten(self, values: np.ndarray, imu: CarriedImu | None = None) -> np.ndarray:
        """(M,) numbers of unit variance for one repeat's noise, from (N, C) in the channels' units. Linear in `values`.

        They are rows of C, in time, without those in which the record fades.
        """
        count = len(values) - FILTER_ORDER
        length = self._length_of(count)
        lines = self._lines(values, imu, length)
        fade, end = fading(count, self.end_s * self.rate_Hz)
        whitened = np.asarray(scipy.fft.irfft(lines, length, axis=0))[end : count - end].ravel()
        whitened *= np.sqrt(count) / fade.max()
        return whitened

    def taken_back(self, whitened: np.ndarray, rows: int, imu: CarriedImu | None = None) -> np.ndarray:
        """(rows, C), the adjoint of `whiten`: its product with values is that of their whitened numbers with `whitened` (M,)."""
        count = rows - FILTER_ORDER
        fade, end = fading(count, self.end_s * self.rate_Hz)
        length = self._length_of(count)
        whole = np.zeros((length, len(self.std)))
        whole[end : count - end] = whitened.reshape(-1, len(self.std)) / fade.max()
        lines = np.conj(np.swapaxes(_roots_of(self, length), 1, 2)) @ np.fft.rfft(whole, axis=0)[:, :, None]
        values = filtered_back(self.filters, np.fft.irfft(lines[:, :, 0], length, axis=0)[:count] * fade[:, None])
        return values if imu is None or self.kind == "assumed" else imu.without_taken_back(values)

    def _length_of(self, count: int) -> int:
        """Of the transform: zeros may follow a record that has faded, and lengths without large prime factors take a third of the time."""
        return int(scipy.fft.next_fast_len(count, real=True)) if self.end_s > 0.0 else count

    def size(self, rows: int) -> int:
        """How many numbers `whiten` makes of this many rows."""
        count = rows - FILTER_ORDER
        return (count - 2 * fading(count, self.end_s * self.rate_Hz)[1]) * len(self.std)

    def backwards(self, whitened: np.ndarray) -> np.ndarray:
        """`whiten`'s numbers (M,) with the record run backwards."""
        return np.ascontiguousarray(whitened.reshape(-1, len(self.std))[::-1]).ravel()


@lru_cache(maxsize=16)
def _of_mean(noise: NoiseModel, repeats: int) -> NoiseModel:
    assert noise.shared is not None
    inverse = np.linalg.inv(noise.roots)
    own = inverse @ np.conj(np.swapaxes(inverse, 1, 2))
    roots = np.stack([inverse_root(s) for s in own + repeats * noise.shared])
    return replace(noise, roots=roots, shared=None)


@lru_cache(maxsize=16)
def _roots_of(noise: NoiseModel, length: int) -> np.ndarray:
    """(K, C, C) S^(-1/2) at the lines of a transform of this length, linear between the grid's neighbours."""
    frequencies = np.fft.rfftfreq(length, 1.0 / noise.rate_Hz)
    place = np.clip(np.interp(frequencies, noise.grid_Hz, np.arange(len(noise.grid_Hz))), 0.0, len(noise.grid_Hz) - 1.000001)
    low = place.astype(int)
    share = (place - low)[:, None, None]
    return (1.0 - share) * noise.roots[low] + share * noise.roots[low + 1]


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
    recorded = [deviations_of(group.complete) for group in repeated]
    deviations = [rows if group.imu is None else group.imu.without(rows) for group, rows in zip(repeated, recorded, strict=True)]
    floor = sensor_floor(channels, machine)
    if all(np.all(group.complete == group.complete[0]) for group in repeated) and np.any(floor <= NO_FLOOR):
        same = ", ".join(label for group in repeated for label in group.labels)
        raise RecordingError(
            f"{same}: the same to the last digit; repeats of an experiment differ by its noise: give recordings, not copies of one"
        )
    std = rms_of([row for group in recorded for row in group], floor)
    rows = [row for group in deviations for row in group]
    common = [each for _, each in shared]
    uncarried = [each if group.imu is None else group.imu.without(each) for group, each in shared]
    left = rms_of(rows + uncarried, floor)
    filters = np.stack([prediction_error_filter([row[:, c] for row in rows + uncarried], left[c]) for c in range(len(channels))])
    rate_Hz = machine.sample_rate_Hz
    frequencies, lines = lines_of_all(filters, rows, rate_Hz)
    # the mean was taken from the same repeats: R - 1 of R deviations are free, and their scale says so already
    free = sum(group.repeats - 1 for group in repeated) / sum(group.repeats for group in repeated)
    grid = grid_of(rate_Hz, max(len(row) for row in rows))
    spectra, freedom = smoothed(lines, frequencies, grid, free, FREEDOM_PER_CHANNEL * len(channels))
    floors = floor**2 * gains_of(filters, grid, rate_Hz)
    roots = whitening(spectra, freedom, floors)
    power = power_of_left_out(deviations, filters, floors, rate_Hz, grid)
    if power is None:
        power = np.maximum(power_of(roots, grid, lines, frequencies), 1.0)
    _, with_carried = lines_of_all(filters, [row for group in recorded for row in group], rate_Hz)
    whole, _ = smoothed(with_carried, frequencies, grid, free, FREEDOM_PER_CHANNEL * len(channels))
    own = np.maximum(np.diagonal(whole, axis1=1, axis2=2).real, floors)
    least = np.minimum(floor, sensor_floor(channels, repeated[0].machine))  # deviations hold what a coarser lattice rounds
    density = np.maximum(density_of([row for group in recorded for row in group], rate_Hz, grid), least**2)
    roots = roots / np.sqrt(power)[:, :, None]
    between = None
    if shared:
        std = np.hypot(std, rms_of(common, np.zeros_like(floor)))
        own = own + np.diagonal(spectra_of_common(filters, common, rate_Hz, grid), axis1=1, axis2=2).real
        density = density + density_of(common, rate_Hz, grid)
        between = spectra_of_common(filters, uncarried, rate_Hz, grid)
    return NoiseModel(kind, std, rate_Hz, filters, grid, roots, np.sqrt(own), density, float(freedom.min()), END_s, between)


def assumed_noise(residuals: Sequence[np.ndarray], channels: Sequence[str], machine: Machine) -> NoiseModel:
    """Noise of single recordings, bounded per channel by what is left of the residual between its strong lines, and taken for white.

    The median of neighbouring lines' power, and of that over octaves, stands for the noise: mismatch that is concentrated in frequency
    does not raise it. Nothing tells a slow disturbance from a slow mismatch in a single recording: noise of the residual's own colour would
    leave only the mismatch's edges visible (on `emps`, Coulomb friction's reversals without its plateaus).
    """
    floor = sensor_floor(channels, machine)
    rate_Hz = machine.sample_rate_Hz
    count = len(channels)
    std = rms_of(residuals, floor)
    filters = np.stack([prediction_error_filter([row[:, c] for row in residuals], std[c]) for c in range(count)])
    grid = grid_of(rate_Hz, max(len(row) for row in residuals))
    places, lines = lines_of_all(filters, residuals, rate_Hz, 0.0)
    power, place = np.abs(np.concatenate(lines)) ** 2, np.concatenate(places)
    spacing = rate_Hz / max(len(row) for row in residuals)
    gains = gains_of(filters, grid, rate_Hz)
    levels = np.zeros((len(grid), count))
    for g, f in enumerate(grid):
        near = np.abs(place - f) <= max(10.5 * spacing, 0.3 * f)
        levels[g] = np.median(power[near], axis=0) / np.log(2.0) + floor**2 * gains[g]  # of an exponential distribution, ln 2 of the mean
    white = np.minimum(np.median(levels / gains, axis=0), std**2)
    roots = np.zeros((len(grid), count, count), dtype=complex)
    own = np.sqrt(white * gains)
    roots[:, np.arange(count), np.arange(count)] = 1.0 / own
    density = np.broadcast_to(white, gains.shape)
    return NoiseModel("assumed", np.sqrt(white), rate_Hz, filters, grid, roots, own, density, np.inf, 0.0)


def sensor_floor(channels: Sequence[str], machine: Machine) -> np.ndarray:
    """(C,) least noise rms of every channel: rounding of its lattice."""
    least: dict[str, float] = {}
    for encoder in machine.plant.encoders:
        least[encoder.channel] = encoder.resolution
    for speed in machine.plant.speeds:
        least[speed.channel] = speed.resolution
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
