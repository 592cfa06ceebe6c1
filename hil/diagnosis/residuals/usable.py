"""Which channels of recordings can be diagnosed, and what is said where one cannot be, or where a run began otherwise than simulated."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np

from hil.diagnosis.recorded.repeated import MEDIAN_OF_THIRD_DIFFERENCES, START_DEVIATIONS, Member
from hil.diagnosis.residuals.noise import NO_FLOOR, sensor_floor
from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.residuals.spectra import FILTER_ORDER
from hil.errors import RecordingError
from hil.machine import Machine
from hil.machine.model import AxisUnits
from hil.recording import Recording, RecordingWarning
from hil.simulation.simulate import axes_with_feedforward, imu_units, position_channel

SILENT = 1e-12
"""A channel that varies by less than this share of its largest value, recorded and simulated, is left out: what is left is rounding."""

LEAST_ROWS = FILTER_ORDER + 4
"""Of a recording: fewer leave nothing behind the noise's filter to judge by."""

LARGEST_READING = 1e30
"""In whatever unit: its square is still a number."""

LARGEST_MISSING_SHARE = 0.5
"""A channel that misses more of its samples than this is left out."""

SAME = 1e-9
"""Of a channel's range: repeats that differ by less everywhere differ by rounding, which is no sensor's noise."""

TRANSIENT = 5.0
"""Times what the other periods differ by, by which a first one does that a start's transient is in."""

FIRST_ROWS = 6
"""From which it is told whether a run was in motion at row 0."""

IN_MOTION = 0.1
"""Of the largest speed between so many rows, by which the first ones move away from the simulation where a run began in motion."""

MOST_OF_A_WAY = 0.7
"""Of the way of so many rows that one step makes, from which it is a jump."""

Drawn = tuple[list[Member], Mapping[str, np.ndarray]]
"""Repeats, and the simulated channels of their experiment."""


def channels_in_common(machine: Machine, groups: Sequence[Drawn]) -> tuple[str, ...]:
    """Channels that are recorded and simulated everywhere and move in one of both.

    Raises
    ------
    RecordingError
        There is none.

    Warns
    -----
    RecordingWarning
        Of those that some recordings lack, or of which most samples are missing.
    """
    drawn = [(member.label, member.recording, simulated) for group, simulated in groups for member in group]
    first_simulated = drawn[0][2]
    pairs = [(recording, simulated) for _, recording, simulated in drawn]
    _warn_of_other_efforts(machine, [(label, recording) for label, recording, _ in drawn])
    closed = bool(machine.controllers)
    shown = {f"command_{units.axis}" for units in machine.units if _is_effort_measured(units, pairs)}
    chosen = []
    for name in first_simulated:
        if name.startswith("command_") and (not closed or name in shown):  # given, or shown by what the drive measured
            continue
        if not all(name in simulated for _, simulated in pairs):
            continue
        if lacking := [label for label, recording, _ in drawn if missing_share(recording, name) > LARGEST_MISSING_SHARE]:
            if any(name in recording for recording, _ in pairs):
                words = f"{', '.join(lacking)}: no {name}, or most of its samples missing; the channel is left out of the diagnosis"
                warnings.warn(words, RecordingWarning, stacklevel=3)
            continue
        if all(_is_silent(recording[name]) and _is_silent(simulated[name]) for recording, simulated in pairs):
            continue
        chosen.append(name)
    if not chosen:
        raise RecordingError("no channel in common with the simulation besides the inputs; record position, current or IMU")
    return tuple(chosen)


def _is_effort_measured(units: AxisUnits, pairs: Sequence[tuple[Recording, Mapping[str, np.ndarray]]]) -> bool:
    """Whether all recordings have a drive's measured effort, by the name that its unit gives it, and it is simulated."""
    name = f"{'current' if units.effort == 'A' else 'effort'}_{units.axis}"
    return all(name in simulated and missing_share(recording, name) <= LARGEST_MISSING_SHARE for recording, simulated in pairs)


def check_units(machine: Machine, label: str, recording: Recording, channels: Sequence[str]) -> None:
    """RecordingError where a channel that is compared is in another unit than its simulation."""
    wanted = imu_units(machine)
    for units in machine.units:
        wanted |= {f"{group}_{units.axis}": units.position for group in ("position", "link_position")}
        wanted |= {f"{group}_{units.axis}": units.effort for group in ("command", "effort", "current")}
        wanted[f"speed_{units.axis}"] = f"{units.position}/s"
    for name in channels:
        unit = recording.channel(name).unit
        if unit != wanted.get(name, unit):
            raise RecordingError(f"{label}: {name} is in [{unit}]; {machine.name} reads it in [{wanted[name]}]")


def check_usable(member: Member, channels: Sequence[str]) -> None:
    """RecordingError where a channel that the others are judged by is absent, mostly missing or holds what no sensor reads."""
    if member.recording.rows < LEAST_ROWS:
        raise RecordingError(f"{member.label}: {member.recording.rows} rows; {LEAST_ROWS} at least, and seconds of motion, are needed")
    for name in channels:
        share = missing_share(member.recording, name)
        if share > LARGEST_MISSING_SHARE:
            has = f"misses {share:.0%} of its samples" if name in member.recording else "is not in it"
            raise RecordingError(f"{member.label}: {name} {has}; the recordings to fit to have it: hold out one that has it too")
        values = member.recording[name]
        senseless = np.flatnonzero(np.abs(values) > LARGEST_READING)
        if senseless.size:
            raise RecordingError(
                f"{member.label}: {name} is {values[senseless[0]]:g} in row {senseless[0]}; leave a reading empty that is missing"
            )


def that_differ(machine: Machine, groups: Sequence[RepeatGroup], channels: tuple[str, ...]) -> tuple[str, ...]:
    """Channels without those that are the same in all repeats and whose sensor has no resolution: nothing says what their noise is.

    Warns
    -----
    RecordingWarning
        Of each that is left out.

    Raises
    ------
    RecordingError
        No channel differs by more than rounding, and some sensor has no resolution: the recordings are copies.
    """
    repeated = [group.measured for group in groups if group.repeats > 1]
    same = [all(_are_the_same(measured[:, :, column]) for measured in repeated) for column in range(len(channels))]
    no_floor = sensor_floor(channels, machine) <= NO_FLOOR
    are_equal = all(np.array_equal(measured, np.broadcast_to(measured[0], measured.shape), equal_nan=True) for measured in repeated)
    if repeated and all(same) and np.any(no_floor) and not are_equal:  # those the noise model refuses
        labels = ", ".join(label for group in groups if group.repeats > 1 for label in group.labels)
        raise RecordingError(f"{labels}: the same but for rounding; repeats differ by noise: give recordings, not copies of one")
    if not repeated or all(same):
        return channels
    dead = [name for name, is_same, is_without in zip(channels, same, no_floor, strict=True) if is_same and is_without]
    for name in dead:
        words = f"{name}: the same in all repeats, and {machine.name} gives its sensor no resolution: its noise is unknown; it is left out"
        warnings.warn(words, RecordingWarning, stacklevel=3)
    return tuple(name for name in channels if name not in dead)


def _are_the_same(values: np.ndarray) -> bool:
    """Whether the rows of (R, N) differ by rounding alone."""
    found = values[:, np.isfinite(values).all(axis=0)]
    if not found.size:  # none has a sample where another has one: nothing says so
        return False
    apart = (found.max(axis=0) - found.min(axis=0)).max()
    return bool(apart <= SAME * (found.max() - found.min()))


def settled_rows(member: Member) -> int:
    """Rows at the beginning that are not judged; RecordingError where the metadata give no such number."""
    rows = member.recording.experiment.get("settle_rows", 0)
    if isinstance(rows, bool) or not isinstance(rows, int) or not 0 <= rows <= max(member.recording.rows - LEAST_ROWS, 0):
        right = f"a whole number of rows from 0 to {max(member.recording.rows - LEAST_ROWS, 0)} would be right"
        raise RecordingError(f"{member.label}: metadata experiment.settle_rows is {rows!r}; {right}")
    return rows


def check_periods(member: Member) -> None:
    """RecordingError where the metadata say of periods what is no whole number."""
    for key in ("period_samples", "settle_periods"):
        value = member.recording.experiment.get(key)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
            right = "a whole number would be right, and none where nothing is periodic"
            raise RecordingError(f"{member.label}: metadata experiment.{key} is {value!r}; {right}")


def warn_of_motion_at_the_start(machine: Machine, groups: Sequence[Drawn]) -> None:
    """Say of which recordings the first rows move away from their simulation, which begins at standstill."""
    for members, simulated in groups:
        first = members[0]
        if first.inputs.start_speed is not None or settled_rows(first) or first.recording.experiment.get("settle_periods"):
            continue
        moving = [axis for axis in machine.axes if any(_begins_in_motion(member, axis, simulated) for member in members)]
        if moving:
            words = (
                f"{', '.join(member.label for member in members)}: {', '.join(moving)} began in motion, the simulation begins at"
                " standstill; metadata initial.speeds say how fast it was, experiment.settle_rows what not to judge"
            )
            warnings.warn(words, RecordingWarning, stacklevel=3)


def warn_of_a_first_period(member: Member, measured: np.ndarray) -> None:
    """Say of a periodic recording that its first period, of (P, N, C), differs from the others by more than these among themselves."""
    if member.recording.experiment.get("settle_periods") or len(measured) < 3:
        return
    is_transient = []
    for channel in np.moveaxis(measured, 2, 0):
        values = channel[:, np.isfinite(channel).all(axis=0)]  # rows that every period has
        apart = np.std(values - np.mean(values[1:], axis=0), axis=1) if values.size else np.zeros(len(values))
        is_transient.append(apart[0] > TRANSIENT * apart[1:].max())
    if any(is_transient):
        words = (
            f"{member.label}: its first period differs from the others by more than {TRANSIENT:g} times what these do: the transient of its"
            " start counts as noise; metadata experiment.settle_periods say how many to leave out"
        )
        warnings.warn(words, RecordingWarning, stacklevel=4)


def _begins_in_motion(member: Member, axis: str, simulated: Mapping[str, np.ndarray]) -> bool:
    """By the speed at row 0 of a parabola through what the first rows have beyond the simulation, against the longest way in as many rows
    and against the readings' noise: what a simulation accelerates wrongly has none.
    """
    name = position_channel(member.recording, axis)
    if name is None or name not in simulated or member.recording.rows <= 4 * FIRST_ROWS:
        return False
    values = member.recording[name]
    beyond = (values - simulated[name])[: FIRST_ROWS + 1]
    ways = np.abs(values[FIRST_ROWS:] - values[:-FIRST_ROWS])
    third = np.diff(values, 3)
    if not np.isfinite(beyond).all() or not np.isfinite(ways).any():
        return False
    rows = np.arange(FIRST_ROWS + 1) / FIRST_ROWS
    design = np.column_stack([np.ones_like(rows), rows, rows**2])
    speed = float(np.linalg.lstsq(design, beyond, rcond=None)[0][1])  # in so many rows
    of_noise = float(np.sqrt(np.linalg.inv(design.T @ design)[1, 1]))
    noise = _median_size(third) / MEDIAN_OF_THIRD_DIFFERENCES
    steps = np.diff(beyond) * np.sign(speed)
    goes_on = float(steps.max(initial=0.0)) < MOST_OF_A_WAY * float(steps.sum())  # a jump, of an encoder's offset say, is one step
    return abs(speed) > max(IN_MOTION * float(np.nanmax(ways)), START_DEVIATIONS * of_noise * noise) and goes_on


def _median_size(values: np.ndarray) -> float:
    values = np.abs(values[np.isfinite(values)])
    return float(np.median(values)) if values.size else 0.0


def warn_of_feedforward(groups: Sequence[Drawn]) -> None:
    """Say which recordings have a feedforward that their controllers do not add, and that is not simulated therefore."""
    lacking: dict[str, list[str]] = {}
    for member in (member for members, _ in groups for member in members):
        adds = axes_with_feedforward(member.machine)
        for axis in member.machine.axes if member.machine.controllers else ():
            name = f"feedforward_{axis}"
            if axis not in adds and name in member.recording and np.nan_to_num(member.recording[name]).any():
                lacking.setdefault(name, []).append(member.label)
    for name, labels in lacking.items():
        axis = name.removeprefix("feedforward_")
        words = f"{', '.join(labels)}: {name} is recorded and not simulated: the controller of {axis} has no `gravity_feedforward`"
        warnings.warn(words, RecordingWarning, stacklevel=3)


def _warn_of_other_efforts(machine: Machine, recordings: Sequence[tuple[str, Recording]]) -> None:
    """Say where a drive's measured effort goes by the name of another unit's."""
    for units in machine.units:
        right, other = ("current", "effort") if units.effort == "A" else ("effort", "current")
        names = f"{other}_{units.axis}", f"{right}_{units.axis}"
        labels = [label for label, recording in recordings if names[0] in recording and names[1] not in recording]
        if labels:
            words = (
                f"{', '.join(labels)}: {names[0]} is not compared: the drive of {machine.name} is in {units.effort}, and its"
                f" measured effort is {names[1]} [{units.effort}]"
            )
            warnings.warn(words, RecordingWarning, stacklevel=4)


def missing_share(recording: Recording, name: str) -> float:
    """Of a channel's samples; 1 where the recording has no such channel."""
    return float(recording.channel(name).missing.mean()) if name in recording else 1.0


def _is_silent(values: np.ndarray) -> bool:
    values = values[np.isfinite(values)]
    return values.size == 0 or bool(np.ptp(values) <= SILENT * max(np.abs(values).max(), 1e-300))
