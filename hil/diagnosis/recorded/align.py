"""Before anything is explained: recordings on the machine's own sample times, with a warning where they were not."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Set
from math import ceil
from typing import Any

import numpy as np

from hil.diagnosis.recorded.lost_ticks import with_every_tick
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Channel, Recording, RecordingWarning
from hil.recording.channels import is_whole
from hil.simulation.simulate import RATE_TOLERANCE

INPUTS = ("reference_", "excitation_", "feedforward_")
HELD = (*INPUTS, "damping_", "command_")
"""Channels that keep their value until the next row; the others are taken linearly between rows."""

HELD_AT = 0.499
"""So far behind a sample time, in the shorter of both sample periods, the row in force is the sample's: in the middle, for a row stamped
late belongs to its tick; of rows that come faster than samples, the one where the sample begins, for measured values are taken there too.
A hair less than half: a row that begins in the very middle leaves the sample to the one before it."""

WHOLE = 1e-6
"""So far, relatively, from a whole number of the machine's rows a period may be."""

PERIOD_KEYS = ("period_samples", "settle_periods", "periods")
"""Of the experiment's metadata: what makes a recording a periodic one."""

LONGEST_GAP = 4.0
"""Rows of the machine's sample period over which measured values are interpolated; across longer gaps they are missing."""


def aligned(machine: Machine, recordings: Mapping[str, Recording]) -> dict[str, Recording]:
    """Recordings on the machine's own sample times, a row for every tick: what was measured is missing where a run skipped some.

    Warns
    -----
    RecordingWarning
        Where rows were not equally spaced, or not at the machine's rate, and have been resampled; where that leaves no whole periods.
    """
    even = {label: _on_equal_rows(machine, label, recording) for label, recording in recordings.items()}
    moved = {label for label, recording in recordings.items() if even[label] is not recording}
    return _equally_long(machine, with_every_tick(even), moved)


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
    return resampled(recording, machine.sample_rate_Hz, label)


def resampled(recording: Recording, rate_Hz: float, label: str = "the recording") -> Recording:
    """A recording on equally spaced rows from its first to its last time, and what its metadata count in rows counted in these.

    Parameters
    ----------
    recording : Recording
    rate_Hz : float
    label : str
        What a warning calls it.

    Warns
    -----
    RecordingWarning
        Where its period is no whole number of the new rows: it is no periodic recording then.
    """
    time = recording.time
    count = int(np.floor((time[-1] - time[0]) * rate_Hz + 1e-6)) + 1
    even = time[0] + np.arange(count) / rate_Hz
    middle = even + HELD_AT * min(1.0 / rate_Hz, float(np.median(np.diff(time))))
    in_force = np.clip(np.searchsorted(time, middle, side="right") - 1, 0, len(time) - 1)
    channels = {"time": Channel("s", even)}
    for name, channel in recording.channels.items():
        if name == "time":
            continue
        values = channel.values
        if name.startswith(HELD) or is_whole(name):
            channels[name] = Channel(channel.unit, values[in_force])
            continue
        there = np.flatnonzero(np.isfinite(values))
        if there.size < 2:
            channels[name] = Channel(channel.unit, np.full(count, np.nan))
            continue
        taken = np.interp(even, time[there], values[there], left=np.nan, right=np.nan)
        after = np.clip(np.searchsorted(time[there], even), 0, len(there) - 1)
        width = time[there][after] - time[there][np.maximum(after - 1, 0)]
        channels[name] = Channel(channel.unit, np.where(width * rate_Hz > LONGEST_GAP, np.nan, taken))
    counted = {"experiment": _counted_in_new_rows(recording, rate_Hz, label)} if recording.experiment else {}
    return Recording(channels, {**recording.metadata, **counted})


def _counted_in_new_rows(recording: Recording, rate_Hz: float, label: str) -> dict[str, Any]:
    """The experiment's metadata; settling rows are rounded up. Lines, amplitudes and numbers of periods stay what they are."""
    experiment = recording.experiment
    ratio = _new_rows_per_row(recording, rate_Hz)
    if isinstance(settle := experiment.get("settle_rows"), int):
        experiment["settle_rows"] = ceil(settle * ratio * (1.0 - WHOLE))
    if isinstance(samples := experiment.get("period_samples"), int):
        period = samples * ratio
        if abs(period - round(period)) <= WHOLE * period:
            experiment["period_samples"] = round(period)
        else:
            words = f"{label}: its period of {samples} rows is {period:.6g} rows at {rate_Hz:g} Hz, no whole number; not split into periods"
            warnings.warn(words, RecordingWarning, stacklevel=5)
            experiment = {key: value for key, value in experiment.items() if key not in PERIOD_KEYS}
    return experiment


def _new_rows_per_row(recording: Recording, rate_Hz: float) -> float:
    """1 where the recorder's rows, lost ones counted, stay within half a row of the new ones to the end: its stamps tell no better."""
    steps, span = np.diff(recording.time), float(recording.time[-1] - recording.time[0])
    rows = float(np.rint(steps / np.median(steps)).sum())
    ratio = span * rate_Hz / rows
    return 1.0 if abs(ratio - 1.0) <= RATE_TOLERANCE and abs(span * rate_Hz - rows) < 0.5 else ratio


def _equally_long(machine: Machine, recordings: Mapping[str, Recording], moved: Set[str]) -> dict[str, Recording]:
    """Repeats that resampling left a row apart, cut to the shortest: a last time a hair before its tick costs a row."""
    groups: list[list[str]] = []
    for label, recording in recordings.items():
        for group in groups:
            if all(_repeat_but_for_a_row(machine, recording, recordings[other]) for other in group):
                group.append(label)
                break
        else:
            groups.append([label])
    cut = dict(recordings)
    for group in groups:
        shortest = min(recordings[label].rows for label in group)
        for label in group if not moved.isdisjoint(group) else ():
            if recordings[label].rows > shortest:
                cut[label] = recordings[label].part(slice(shortest))
    return cut


def _repeat_but_for_a_row(machine: Machine, one: Recording, other: Recording) -> bool:
    if abs(one.rows - other.rows) > 1 or one.machine_hash != other.machine_hash:
        return False
    if one.experiment.get("start_pose") != other.experiment.get("start_pose"):
        return False
    inputs = INPUTS if machine.controllers else (*INPUTS, "command_")
    rows = min(one.rows, other.rows)
    driven = {name for name in (*one.channels, *other.channels) if name.startswith(inputs)}
    return all(name in one and name in other and np.array_equal(one[name][:rows], other[name][:rows], equal_nan=True) for name in driven)
