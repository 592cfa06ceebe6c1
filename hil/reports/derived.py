"""Channels that are made of a recording's others, and recordings laid over each other: difference, derivative, spectrum, alignment."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate, correlation_lags

from hil.errors import RecordingError, UnusableInputError
from hil.recording import Channel, Recording

HOW = "A - B, d(A), or spectrum(A), with the names of channels"
_FORMS = (("difference", r"(\w+)\s*-\s*(\w+)"), ("derivative", r"d\(\s*(\w+)\s*\)"), ("spectrum", r"spectrum\(\s*(\w+)\s*\)"))

AS_GOOD = 1e-6
"""Difference of correlation coefficients below which two lags are as good: some times what the sums are rounded by."""
STILL = 1e-3
"""Variance of the rows that overlap, as a share of the whole channel's, below which it counts as standing still there."""


@dataclass(frozen=True)
class Derived:
    """A derived channel: its text, which of the three it is, and the channels it is made of."""

    text: str
    kind: str
    of: tuple[str, ...]


def derived_from(text: str) -> Derived:
    """Read `A - B`, `d(A)` or `spectrum(A)`.

    Raises
    ------
    UnusableInputError
        It is none of them.
    """
    for kind, form in _FORMS:
        if found := re.fullmatch(form, text.strip()):
            return Derived(text.strip(), kind, found.groups())
    raise UnusableInputError(f"{text}: is no derived channel; write {HOW}")


def in_time(derived: Derived, recording: Recording) -> Channel:
    """Return a difference or a derivative of a recording's channels.

    A derivative is by central differences of the rows, at the ends by one-sided ones.

    Raises
    ------
    UnusableInputError
        A channel is absent, a difference is of two units, or a derivative of fewer than two rows.
    """
    channels = [_channel(derived, name, recording) for name in derived.of]
    if derived.kind == "derivative":
        (one,) = channels
        if recording.rows < 2:
            raise UnusableInputError(f"{derived.text}: has {recording.rows} rows; a derivative needs two")
        unit = {"": "1/s", "rad/s": "rad/s^2", "m/s": "m/s^2"}.get(one.unit, f"{one.unit}/s")
        return Channel(unit, np.gradient(one.values, recording.time))
    one, other = channels
    if one.unit != other.unit:
        raise UnusableInputError(
            f"{derived.text}: {derived.of[0]} is in {one.unit or 'no unit'}, {derived.of[1]} in {other.unit or 'no unit'}"
        )
    return Channel(one.unit, one.values - other.values)


def spectrum(derived: Derived, recording: Recording) -> tuple[np.ndarray, Channel]:
    """Return frequencies (F,) [Hz] and amplitudes (F,) of a channel, in its unit: a sine on a line shows its amplitude.

    Under a Hann window, about the mean; rows that are missing are interpolated, and the mean interval of the rows is taken for all.

    Raises
    ------
    UnusableInputError
        The channel is absent, or has fewer than four rows.
    """
    channel = _channel(derived, derived.of[0], recording)
    known = np.isfinite(channel.values)
    if known.sum() < 4:
        raise UnusableInputError(f"{derived.text}: has {known.sum()} rows; a spectrum needs four")
    time = recording.time
    values = np.interp(time, time[known], channel.values[known])
    window = np.hanning(time.size + 1)[:-1]  # periodic
    amplitudes = 2.0 * np.abs(np.fft.rfft(window * (values - values.mean()))) / window.sum()
    interval_s = (time[-1] - time[0]) / (time.size - 1)
    return np.fft.rfftfreq(time.size, interval_s), Channel(channel.unit, amplitudes)


def shift_to(first: Recording, other: Recording, name: str) -> float:
    """Return the time [s] to add to the other's so that its channel lies best over the first's.

    Where their correlation coefficient over the rows that overlap is largest, of which there must be half of the shorter one's; of several
    places that are as good, as in periodic motion, the nearest.

    Raises
    ------
    UnusableInputError
        One has no such channel, or it does not change.
    """
    interval_s = (first.time[-1] - first.time[0]) / max(1, first.rows - 1)
    signals = []
    for recording in (first, other):
        channel = _channel(Derived(f"--align {name}", "alignment", (name,)), name, recording)
        known = np.isfinite(channel.values)
        if known.sum() < 4 or np.ptp(channel.values[known]) == 0.0:
            raise UnusableInputError(f"--align {name}: it does not change, so nothing can be aligned by it")
        at = np.arange(recording.time[0], recording.time[-1] + 0.5 * interval_s, interval_s)
        values = np.interp(at, recording.time[known], channel.values[known])
        signals.append((values - values.mean()) / values.std())
    lags = correlation_lags(signals[0].size, signals[1].size)
    alike = np.where(_overlaps(*signals) >= 0.5 * min(map(len, signals)), _coefficients(*signals), -np.inf)
    best = min(lags[alike >= alike.max() - AS_GOOD], key=abs)
    return float(first.time[0] - other.time[0] + best * interval_s)


def _overlaps(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Return the rows that overlap at each lag."""
    rows: np.ndarray = np.round(correlate(np.ones_like(one), np.ones_like(two), method="fft"))
    return rows


def _coefficients(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Return the correlation coefficient over the rows that overlap at each lag; 0 where one of them stands still there."""

    def summed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        found: np.ndarray = correlate(a, b, method="fft")
        return found

    rows = np.maximum(_overlaps(one, two), 1.0)
    ones_one, ones_two = np.ones_like(one), np.ones_like(two)
    mean_one, mean_two = summed(one, ones_two) / rows, summed(ones_one, two) / rows
    spread = (summed(one**2, ones_two) / rows - mean_one**2) * (summed(ones_one, two**2) / rows - mean_two**2)
    shared = summed(one, two) / rows - mean_one * mean_two
    still = spread < STILL**2
    return np.where(still, 0.0, shared / np.sqrt(np.where(still, 1.0, spread)))


def _channel(derived: Derived, name: str, recording: Recording) -> Channel:
    try:
        return recording.channel(name)
    except RecordingError as error:
        raise UnusableInputError(f"{derived.text}: {error}") from None
