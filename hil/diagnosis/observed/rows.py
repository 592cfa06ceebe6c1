"""A recording on rows of one period: what acted on the machine from each row to the next, and what its sensors read there."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.audit.readings import FEWEST_ROWS
from hil.errors import RecordingError
from hil.machine import Machine
from hil.recording import Recording
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.settings import PlantSettings

LARGEST = 1e30
"""Of a reading: no sensor has more, and squares of more are no numbers."""


WIDEST_GAP = 2.5
"""Between two samples [periods], across which a reading is a straight line."""


@dataclass(frozen=True, eq=False)
class Observed:
    """One recording on N rows.

    Attributes
    ----------
    name : str
    machine : Machine
    recording : Recording
    time : (N,) array
        [s] from the first row on.
    period_s : float
    targets : (N, axes) array
        What the drives were told to bring about from each row to the next, in their units, on their lattice.
    currents : (N, axes) array
        What they measured at the rows; NaN where they did not.
    channels : tuple of str
        Encoders, speed sensors, IMUs, as far as they were recorded.
    readings : (N, m) array
        NaN where a sample is missing.
    begin_s : float
        When the first row is in the recording.
    imposed : tuple of str
        Axes whose efforts nobody recorded: how they move is given, and says nothing of their drives.
    """

    name: str
    machine: Machine
    recording: Recording
    time: np.ndarray
    period_s: float
    targets: np.ndarray
    currents: np.ndarray
    channels: tuple[str, ...]
    readings: np.ndarray
    begin_s: float = 0.0
    imposed: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """N."""
        return len(self.time)

    @cached_property
    def are_measured(self) -> np.ndarray:
        """Which targets (axes,) are measured efforts, since no command was recorded: what a drive makes of commands is in them."""
        same: np.ndarray = np.all((self.currents == self.targets) | np.isnan(self.currents), axis=0) & ~np.isnan(self.currents).all(axis=0)
        return same

    def part(self, rows: slice) -> Observed:
        """Return some of the rows in a row."""
        time = self.time[rows]
        return replace(
            self, time=time - time[0], begin_s=self.begin_s + float(time[0]), targets=self.targets[rows], currents=self.currents[rows],
            readings=self.readings[rows],
        )  # fmt: skip

    def with_channels(self, channels: Sequence[str]) -> Observed:
        """Return the same with some of its channels."""
        return replace(self, channels=tuple(channels), readings=self.readings[:, [self.channels.index(channel) for channel in channels]])

    def coarser(self, by: int) -> Observed:
        """Return every `by`-th row of running means over as many rows; readings and efforts pass the same filter."""
        if by == 1:
            return self
        begins = np.arange(0, self.rows - 2 * by, by)
        window = begins[:, None] + np.arange(by)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # a mean of missing samples is missing
            readings = np.nanmean(self.readings[window], axis=1)
            currents = np.nanmean(self.currents[window], axis=1)
        running = np.stack([self.targets[window + k].mean(axis=1) for k in range(by)])
        same = self.are_measured
        targets = running.mean(axis=0)  # from each kept row to the next
        currents[:, same] = targets[:, same]
        return replace(
            self, time=np.arange(len(begins)) * by * self.period_s, period_s=by * self.period_s, targets=targets, currents=currents,
            readings=readings,
        )  # fmt: skip

    @cached_property
    def settings(self) -> PlantSettings:
        """The plant with one step a row."""
        return replace(self.machine.plant, sample_period_s=self.period_s, substeps=1)


def between_samples(one: Observed) -> Observed:
    """Return the same with readings of encoders and speed sensors along straight lines between the samples of an uneven recording.

    The nearest sample is off by what the machine moves in up to half a period.
    """
    time = one.recording.time - one.recording.time[0]
    if one.rows == one.recording.rows and np.allclose(time, one.time + one.begin_s - one.recording.time[0]):
        return one
    readings = one.readings.copy()
    at = one.time + one.begin_s - one.recording.time[0]
    continuous = {sensor.channel for sensor in one.machine.plant.joint_sensors}
    for c, channel in enumerate(one.channels):
        if channel not in continuous:
            continue
        values = one.recording[channel]
        there = np.isfinite(values)
        after = np.clip(np.searchsorted(time[there], at), 1, int(there.sum()) - 1)
        is_near = time[there][after] - time[there][after - 1] < WIDEST_GAP * one.period_s
        readings[:, c] = np.where(is_near, np.interp(at, time[there], values[there]), np.nan)
    return replace(one, readings=readings)


def sensor_channels(machine: Machine) -> tuple[str, ...]:
    """Return the channels of positions, speeds and IMUs that a machine has."""
    return (*(sensor.channel for sensor in machine.plant.joint_sensors), *imu_channel_names(machine.plant))


def observed(machine: Machine, name: str, recording: Recording, may_be_imposed: bool = False) -> Observed:
    """Bring a recording onto rows.

    With `may_be_imposed` axes without any effort are taken along, their targets zero.

    Even recordings keep their rows. Uneven ones are read off at their median rate: linear between samples for efforts; sensors at the
    nearest sample, where one is nearer than half a period.

    Raises
    ------
    RecordingError
        No effort was recorded or commanded, or hardly a row.
    """
    time = recording.time - recording.time[0]
    if len(time) < FEWEST_ROWS:
        raise RecordingError(f"{name}: has {len(time)} rows; a diagnosis takes {FEWEST_ROWS} at least")
    for channel in recording.channels:
        senseless = np.flatnonzero(np.abs(np.nan_to_num(recording[channel], nan=0.0, posinf=np.inf, neginf=-np.inf)) > LARGEST)
        if len(senseless):
            row = int(senseless[0])
            what = f"{channel} is {recording[channel][row]:g} in row {row} ({recording.time[row]:g} s)"
            raise RecordingError(f"{name}: {what}; leave a reading empty that was not taken")
    gaps = np.diff(time)
    period = float(np.median(gaps))
    rows = np.arange(len(time)) * period if recording.is_even else np.arange(0.0, time[-1] + 0.5 * period, period)
    commands, currents = _efforts(machine, name, recording)
    tick = min(1.0 / machine.sample_rate_Hz, period)  # after which a command acts
    if recording.is_even:
        acting, flowing = _one_tick_later(commands, tick / period), currents
    else:
        each = ((rows - tick, commands), (rows, currents))
        acting, flowing = (np.column_stack([np.interp(at, time, column) for column in values.T]) for at, values in each)
    missing = np.isnan(acting)
    acting = np.where(missing, flowing, acting)
    lattice = np.array([drive.resolution for drive in machine.plant.drives])
    steps = np.where(lattice > 0.0, lattice, 1.0)
    acting = np.where((lattice > 0.0) & ~missing, np.floor(acting / steps + 0.5) * steps, acting)
    without = np.isnan(acting).all(axis=0) & may_be_imposed
    imposed, acting = tuple(np.array(machine.axes)[without].tolist()), np.where(without, 0.0, acting)
    if np.isnan(acting).any():
        axis = machine.axes[int(np.flatnonzero(np.isnan(acting).any(axis=0))[0])]
        raise RecordingError(f"{name}: neither command_{axis} nor a measured effort of {axis} is complete; one of them is needed")
    channels = tuple(channel for channel in sensor_channels(machine) if channel in recording and np.isfinite(recording[channel]).any())
    readings = recording.matrix(channels) if channels else np.zeros((len(time), 0))
    if not recording.is_even:
        nearest = np.clip(np.searchsorted(time, rows), 1, len(time) - 1)
        nearest -= rows - time[nearest - 1] < time[nearest] - rows
        readings = np.where((np.abs(time[nearest] - rows) < 0.5 * period)[:, None], readings[nearest], np.nan)
    return Observed(name, machine, recording, rows, period, acting, flowing, channels, readings, float(recording.time[0]), imposed)


def _efforts(machine: Machine, name: str, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return commands and measured efforts (M, axes); NaN where there are none."""
    rows = recording.rows
    measured = {sensor.axis: sensor.channel for sensor in machine.plant.currents}
    commands, currents = np.full((rows, len(machine.axes)), np.nan), np.full((rows, len(machine.axes)), np.nan)
    for i, axis in enumerate(machine.axes):
        if f"command_{axis}" in recording:
            commands[:, i] = recording[f"command_{axis}"]
        for channel in (measured.get(axis), f"current_{axis}", f"effort_{axis}"):
            if channel is not None and channel in recording:
                currents[:, i] = recording[channel]
                break
    return commands, currents


def _one_tick_later(commands: np.ndarray, share: float) -> np.ndarray:
    """Return what acts from each row on, on average: a command acts one tick later, a share of a row.

    At the machine's rate the command of row k acts from row k + 1; before the first one what it asks for.
    """
    return share * np.vstack([commands[:1], commands[:-1]]) + (1.0 - share) * commands
