"""Before anything is explained: equal sampling, and whether units, signs and gross delay can be right.

Sampling is put right, with a warning. Units, signs and delays are only pointed out: a channel that is wired the wrong way round or lags is
a finding of its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping

import numpy as np

from hil.diagnosis.lost_ticks import with_every_tick
from hil.diagnosis.mismatch import Mismatch
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Channel, Recording, RecordingWarning
from hil.recording.channels import is_whole
from hil.simulation.simulate import RATE_TOLERANCE

HELD = ("reference_", "excitation_", "feedforward_", "damping_", "command_")
"""Channels that keep their value until the next row; the others are taken linearly between rows."""

LONGEST_GAP = 4.0
"""Rows of the machine's sample period over which measured values are interpolated; across longer gaps they are missing."""

ALIKE = 0.9
"""Correlation from which a channel is the simulation's, but for sign or scale."""

SCALES = {180.0 / np.pi: "degrees for radians", 1000.0: "thousandths", 2.0 * np.pi: "turns for radians", 9.80665: "g for m/s^2"}
SCALE_TOLERANCE = 0.1
LARGEST_LAG_s = 0.1
LEAST_LAG_ROWS = 2
CLEARLY = 0.7
"""A lag is pointed out when it lowers the rms difference below this share."""


def aligned(machine: Machine, recordings: Mapping[str, Recording]) -> dict[str, Recording]:
    """Recordings on the machine's own sample times, a row for every tick: what was measured is missing where a run skipped some.

    Warns
    -----
    RecordingWarning
        Where rows were not equally spaced, or not at the machine's rate, and have been resampled.
    """
    return with_every_tick({label: _on_equal_rows(machine, label, recording) for label, recording in recordings.items()})


def _on_equal_rows(machine: Machine, label: str, recording: Recording) -> Recording:
    try:
        rate = recording.sample_rate_Hz
    except RecordingError as problem:
        if recording.rows < 2:
            raise RecordingError(f"{label}: {problem}") from None
        reason = str(problem)
    else:
        if abs(rate / machine.sample_rate_Hz - 1.0) <= RATE_TOLERANCE:
            return recording
        reason = f"{rate:g} rows a second; {machine.name} runs at {machine.sample_rate_Hz:g} Hz"
    warnings.warn(f"{label}: {reason}; resampled to {machine.sample_rate_Hz:g} Hz", RecordingWarning, stacklevel=4)
    return resampled(recording, machine.sample_rate_Hz)


def resampled(recording: Recording, rate_Hz: float) -> Recording:
    """A recording on equally spaced rows from its first to its last time."""
    time = recording.time
    count = int(np.floor((time[-1] - time[0]) * rate_Hz + 1e-6)) + 1
    even = time[0] + np.arange(count) / rate_Hz
    before = np.clip(np.searchsorted(time, even + 1e-9, side="right") - 1, 0, len(time) - 1)
    channels = {"time": Channel("s", even)}
    for name, channel in recording.channels.items():
        if name == "time":
            continue
        values = channel.values
        if name.startswith(HELD) or is_whole(name):
            channels[name] = Channel(channel.unit, values[before])
            continue
        there = np.flatnonzero(np.isfinite(values))
        if there.size < 2:
            channels[name] = Channel(channel.unit, np.full(count, np.nan))
            continue
        taken = np.interp(even, time[there], values[there], left=np.nan, right=np.nan)
        after = np.clip(np.searchsorted(time[there], even), 0, len(there) - 1)
        width = time[there][after] - time[there][np.maximum(after - 1, 0)]
        channels[name] = Channel(channel.unit, np.where(width * rate_Hz > LONGEST_GAP, np.nan, taken))
    return Recording(channels, recording.metadata)


def suspicions(found: Mismatch) -> tuple[str, ...]:
    """What looks like a wrong unit, a wrong sign or a gross delay: a sentence each."""
    said = []
    for column, name in enumerate(found.channels):
        measured = np.concatenate([_centred(group.mean[:, column]) for group in found.groups])
        simulated = np.concatenate([_centred(group.simulated[:, column]) for group in found.groups])
        power, own = float(simulated @ simulated), float(measured @ measured)
        if power <= 0.0 or own <= 0.0:
            continue
        correlation = float(measured @ simulated) / np.sqrt(power * own)
        slope = float(measured @ simulated) / power
        if correlation < -ALIKE:
            said.append(f"{name} runs against its simulation (correlation {correlation:.2f}): is its sign right?")
        for scale, meaning in SCALES.items():
            for factor in (scale, 1.0 / scale):
                if abs(correlation) > ALIKE and abs(abs(slope) / factor - 1.0) < SCALE_TOLERANCE:
                    said.append(f"{name} is {abs(slope):.3g} times its simulation: {meaning}?")
        lag = _lag_rows(found, column)
        if lag:
            order = "later" if lag > 0 else "earlier"
            said.append(f"{name} comes {abs(lag) / found.noise.rate_Hz * 1e3:.3g} ms {order} than its simulation")
    return tuple(said)


def _lag_rows(found: Mismatch, column: int) -> int:
    """Rows by which a channel is later than its simulation, where that explains the difference clearly better; 0 otherwise."""
    most = round(LARGEST_LAG_s * found.noise.rate_Hz)
    pairs = [(_centred(group.mean[:, column]), _centred(group.simulated[:, column])) for group in found.groups]
    if any(len(measured) <= 4 * most for measured, _ in pairs):
        return 0
    errors = {}
    for lag in range(-most, most + 1):
        errors[lag] = sum(float(np.sum((m[most:-most] - s[most - lag : len(s) - most - lag]) ** 2)) for m, s in pairs)
    best = min(errors, key=lambda lag: (errors[lag], abs(lag)))
    return best if abs(best) >= LEAST_LAG_ROWS and errors[best] < CLEARLY**2 * errors[0] else 0


def _centred(values: np.ndarray) -> np.ndarray:
    return np.asarray(values - values.mean())
