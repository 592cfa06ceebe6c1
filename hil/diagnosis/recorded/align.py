"""Before anything is explained: recordings on the machine's own sample times, with a warning where they were not."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence, Set
from math import ceil
from typing import Any

import numpy as np

from hil.diagnosis.recorded.lost_ticks import with_every_tick
from hil.diagnosis.recorded.repeated import are_equal_inputs, begin_near
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Channel, Recording, RecordingWarning
from hil.recording.channels import is_whole
from hil.recording.model import UNEQUAL_STEP
from hil.recording.ticks import PLANNED, planned
from hil.simulation.simulate import RATE_TOLERANCE, axes_with_feedforward

INPUTS = ("reference_", "excitation_", "feedforward_")
SMOOTH = ("reference_", "feedforward_")
"""Inputs that are smooth: linear between rows however far these are apart, for a simulation needs all of them."""

HELD = ("excitation_", "damping_", "command_")
"""Channels that keep their value until the next row; those that were measured are taken linearly between rows."""

HELD_AT = 0.499
"""So far behind a sample time, in the shorter of both sample periods, the row in force is the sample's: in the middle, for a row stamped
late belongs to its tick; of rows that come faster than samples, the one where the sample begins, for measured values are taken there too.
A hair less than half: a row that begins in the very middle leaves the sample to the one before it."""

WHOLE = 1e-6
"""So far, relatively, from a whole number of the machine's rows a period may be."""

PERIOD_KEYS = ("period_samples", "settle_periods", "periods")
"""Of the experiment's metadata: what makes a recording a periodic one."""

LEAST_COMMON = 0.9
"""Of the longer of two recordings with the same inputs as far as both go, that the shorter one holds at least, to be cut to one length."""

JITTER = 0.05
"""Of a recorder's own row, by which the times of two recordings may differ whose rows are the same."""

LONGEST_GAP = 4.0
"""Rows of the machine's sample period over which measured values are interpolated; across longer gaps they are missing."""

NEXT_ROW = 1.5
"""Of a recorder's own rows, up to which the next one follows: between two of a slower recorder is no gap, however its stamps jitter."""


def aligned(machine: Machine, recordings: Mapping[str, Recording]) -> dict[str, Recording]:
    """Recordings on the machine's own sample times, a row for every tick: what was measured is missing where a run skipped some.

    Warns
    -----
    RecordingWarning
        Where rows were not equally spaced, or not at the machine's rate, and have been resampled; where that leaves no whole periods; where
        a recording is cut to the rows of one that it repeats.
    """
    even = {label: _on_equal_rows(machine, label, recording) for label, recording in recordings.items()}
    moved = {label for label, recording in recordings.items() if even[label] is not recording}
    kept = {label: ticks for label in moved if (ticks := _ticks_kept(recordings[label], machine.sample_rate_Hz)) is not None}
    even = _with_equal_inputs(machine, recordings, even, sorted(moved - kept.keys()))
    return _equally_long(machine, with_every_tick(even, kept, (*_inputs(machine), "reference_", "damping_")), moved)


def _with_equal_inputs(
    machine: Machine, recordings: Mapping[str, Recording], even: Mapping[str, Recording], of_another_rate: Sequence[str]
) -> dict[str, Recording]:
    """Of recordings of another rate those with the same inputs row by row, at the same times but for jitter, have the same between rows:
    those of the one that is longest on the machine's rows.
    """
    inputs = _inputs(machine)
    groups = _grouped(of_another_rate, lambda one, other: _have_the_same_rows(inputs, recordings[one], recordings[other]))
    shared = dict(even)
    for group in groups:
        longest = even[max(group, key=lambda label: even[label].rows)]
        for label in group:
            own = even[label]
            taken = {name: channel for name, channel in longest.channels.items() if name.startswith(inputs)}
            channels = {name: Channel(channel.unit, channel.values[: own.rows]) for name, channel in taken.items()}
            shared[label] = Recording({**own.channels, **channels}, own.metadata)
    return shared


def _grouped(labels: Sequence[str], are_alike: Callable[[str, str], bool]) -> list[list[str]]:
    """Each with the first others that it is like all of."""
    groups: list[list[str]] = []
    for label in labels:
        group = next((group for group in groups if all(are_alike(label, other) for other in group)), None)
        if group is None:
            groups.append([label])
        else:
            group.append(label)
    return groups


def _have_the_same_rows(inputs: tuple[str, ...], one: Recording, other: Recording) -> bool:
    """Whether both have the same inputs at the same times, as far as the shorter one goes."""
    rows, most = sorted((one.rows, other.rows))
    if rows < LEAST_COMMON * most:
        return False
    apart = (one.time[:rows] - one.time[0]) - (other.time[:rows] - other.time[0])
    if np.abs(apart).max() > JITTER * float(np.median(np.diff(one.time))):
        return False
    driven = {name for name in (*one.channels, *other.channels) if name.startswith(inputs)}
    return all(name in one and name in other and are_equal_inputs(one[name][:rows], other[name][:rows]) for name in driven)


def _inputs(machine: Machine) -> tuple[str, ...]:
    """How the names of what drives a simulation begin."""
    if not machine.controllers:
        return "excitation_", "command_"
    return INPUTS if axes_with_feedforward(machine) else tuple(name for name in INPUTS if name != "feedforward_")


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
        if (between := machine.sample_rate_Hz / rate) > LONGEST_GAP * (1.0 + RATE_TOLERANCE):
            reason += f": what moves within {between:.3g} of its rows is not recorded, and interpolated"
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
    recording = _on_its_ticks(recording, rate_Hz)
    time, count = recording.time, _rows_at(recording, rate_Hz)
    even = time[0] + np.arange(count) / rate_Hz
    in_force = _in_force(recording, rate_Hz)
    gap_s = max(LONGEST_GAP / rate_Hz, NEXT_ROW * float(np.median(np.diff(time))))
    kept = _ticks_kept(recording, rate_Hz)
    channels = {"time": Channel("s", even)}
    for name, channel in recording.channels.items():
        if name == "time":
            continue
        values = channel.values
        if kept is not None and name.startswith(PLANNED):
            channels[name] = Channel(channel.unit, planned(recording, name, kept, values[in_force[kept]], count))
            continue
        if name.startswith(SMOOTH):
            channels[name] = Channel(channel.unit, np.interp(even, time, values))
            continue
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
        channels[name] = Channel(channel.unit, np.where(width > gap_s, np.nan, taken))
    counted = {"experiment": _counted_in_new_rows(recording, rate_Hz, label)} if recording.experiment else {}
    return Recording(channels, {**recording.metadata, **counted})


def _rows_at(recording: Recording, rate_Hz: float) -> int:
    return int(np.floor((recording.time[-1] - recording.time[0]) * rate_Hz + 1e-6)) + 1


def _in_force(recording: Recording, rate_Hz: float) -> np.ndarray:
    """(rows,) the recorded row that each new one belongs to."""
    time = recording.time
    middle = time[0] + np.arange(_rows_at(recording, rate_Hz)) / rate_Hz + HELD_AT * min(1.0 / rate_Hz, float(np.median(np.diff(time))))
    return np.clip(np.searchsorted(time, middle, side="right") - 1, 0, len(time) - 1)


def _ticks_kept(recording: Recording, rate_Hz: float) -> np.ndarray | None:
    """New rows that a recorded one belongs to, of a recording at this rate which lost some; None of one at another rate."""
    if abs(_recorded_rate(recording, rate_Hz) - 1.0) > RATE_TOLERANCE:
        return None
    return np.flatnonzero(np.diff(_in_force(_on_its_ticks(recording, rate_Hz), rate_Hz), prepend=-1))


def _on_its_ticks(recording: Recording, rate_Hz: float) -> Recording:
    """With the time of a clock that runs as the machine's does, where it is off by less than another rate: rows stay with their ticks."""
    ratio = _recorded_rate(recording, rate_Hz)
    if abs(ratio - 1.0) > RATE_TOLERANCE:
        return recording
    steps, _, is_whole_step = _steps(recording)
    ticks_s = np.concatenate([[0.0], np.cumsum(np.where(is_whole_step, steps / ratio, steps))])  # a pause lasts as long as it says
    return Recording({**recording.channels, "time": Channel("s", recording.time[0] + ticks_s)}, recording.metadata)


def _counted_in_new_rows(recording: Recording, rate_Hz: float, label: str) -> dict[str, Any]:
    """The experiment's metadata; settling rows are rounded up. Lines, amplitudes and numbers of periods stay what they are."""
    experiment = recording.experiment
    ratio = _new_rows_per_row(recording, rate_Hz)
    if isinstance(settle := experiment.get("settle_rows"), int) and not isinstance(settle, bool):
        experiment["settle_rows"] = ceil(settle * ratio * (1.0 - WHOLE))
    if isinstance(samples := experiment.get("period_samples"), int) and not isinstance(samples, bool):
        period = samples * ratio
        if abs(period - round(period)) <= WHOLE * period:
            experiment["period_samples"] = round(period)
        else:
            words = f"{label}: its period of {samples} rows is {period:.6g} rows at {rate_Hz:g} Hz, no whole number; not split into periods"
            warnings.warn(words, RecordingWarning, stacklevel=5)
            experiment = {key: value for key, value in experiment.items() if key not in PERIOD_KEYS}
    return experiment


def _recorded_rate(recording: Recording, rate_Hz: float) -> float:
    """New rows per recorded row, lost ones counted."""
    steps, rows, is_whole_step = _steps(recording)
    return float(steps[is_whole_step].sum()) * rate_Hz / float(rows[is_whole_step].sum())


def _steps(recording: Recording) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N - 1,) steps [s], how many rows each is, and whether it is so many whole ones; all are where stamps jitter by more."""
    steps = np.diff(recording.time)
    rows = np.rint(steps / np.median(steps))
    is_whole_step = np.abs(steps - rows * np.median(steps)) <= UNEQUAL_STEP * np.median(steps)
    return steps, rows, is_whole_step if is_whole_step.mean() > 0.5 else np.ones(len(steps), dtype=bool)


def _new_rows_per_row(recording: Recording, rate_Hz: float) -> float:
    """1 where the recorder's rows, lost ones counted, stay within half a row of the new ones to the end: its stamps tell no better."""
    ratio, span = _recorded_rate(recording, rate_Hz), float(recording.time[-1] - recording.time[0])
    return 1.0 if abs(ratio - 1.0) <= RATE_TOLERANCE and abs(span * rate_Hz * (1.0 - 1.0 / ratio)) < 0.5 else ratio


def _equally_long(machine: Machine, recordings: Mapping[str, Recording], moved: Set[str]) -> dict[str, Recording]:
    """Repeats of which some end early, cut to the shortest: a last time a hair before its tick costs a resampled one a row."""
    groups = _grouped([*recordings], lambda one, other: _repeat_but_for_the_end(machine, recordings[one], recordings[other]))
    cut = dict(recordings)
    for group in groups:
        rows = {label: recordings[label].rows for label in group}
        shortest = min(rows.values())
        longer = [label for label in group if rows[label] > shortest]
        for label in longer:
            cut[label] = recordings[label].part(slice(shortest))
        said = [label for label in longer if rows[label] > shortest + 1 or moved.isdisjoint(group)]
        if said:
            first = next(label for label in group if rows[label] == shortest)
            words = f"{', '.join(said)}: cut to the {shortest} rows of {first}, which they repeat"
            warnings.warn(words, RecordingWarning, stacklevel=3)
    return cut


def _repeat_but_for_the_end(machine: Machine, one: Recording, other: Recording) -> bool:
    rows, most = sorted((one.rows, other.rows))
    if rows < LEAST_COMMON * most or (one.machine_hash or machine.hash) != (other.machine_hash or machine.hash):
        return False
    if one.experiment.get("start_pose") != other.experiment.get("start_pose"):
        return False
    if one.metadata.get("initial", {}).get("speeds") != other.metadata.get("initial", {}).get("speeds"):
        return False
    if not machine.controllers and one.experiment.get("start_pose") is None and not begin_near(machine, one, other):
        return False
    driven = {name for name in (*one.channels, *other.channels) if name.startswith(_inputs(machine))}
    return all(name in one and name in other and are_equal_inputs(one[name][:rows], other[name][:rows]) for name in driven)
