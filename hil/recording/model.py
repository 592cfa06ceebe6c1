"""A recording: one row per SYNC, named channels with units, and what is known about how it was made."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hil.errors import RecordingError
from hil.files.toml_text import plain
from hil.recording.channels import check_name, unit_and_factor

UNEQUAL_STEP = 0.01
"""Largest deviation of a time step from the mean, as a share of it, that still counts as equal sampling: clocks of real recorders jitter by
some 1e-4 of a period, a lost row is a deviation of 1."""

CAN_FRAMES = "can_frames"
"""Metadata `kind` of a table of raw CAN frames: several may bear the same time."""


@dataclass(frozen=True, eq=False)
class Channel:
    """Values of one signal.

    Parameters
    ----------
    unit : str
        `""` for a plain number.
    values : ndarray, shape (N,), float64
        NaN where the sample is missing.
    """

    unit: str
    values: np.ndarray

    def __post_init__(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    @property
    def missing(self) -> np.ndarray:
        """(N,) bool: where no sample arrived."""
        return np.isnan(self.values)


@dataclass(frozen=True, eq=False)
class Recording:
    """Channels of equal length over one time, and metadata.

    Parameters
    ----------
    channels : mapping of str to Channel
        In file order; `time` is one of them, complete and increasing.
    metadata : mapping
        Tables of plain values (what TOML can hold): `machine` (name, hash, text, axes), `experiment`, `initial`, `software`; see
        docs/formats.md.

    Raises
    ------
    RecordingError
        No time, a hole in it, channels of different length, a unit the channel cannot have.
    """

    channels: Mapping[str, Channel]
    metadata: Mapping[str, Any]

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "metadata", plain(self.metadata))
        except TypeError as problem:
            raise RecordingError(str(problem)) from None
        object.__setattr__(self, "channels", {check_name(name): _in_si(name, channel) for name, channel in self.channels.items()})
        if "time" not in self.channels:
            raise RecordingError("no channel `time [s]`: every recording has one")
        rows = self.rows
        for name, channel in self.channels.items():
            if channel.values.shape != (rows,):
                raise RecordingError(f"channel {name}: shape {channel.values.shape}, but time has {rows} rows; channels are equally long")
        _check_time(self.time, may_repeat=self.metadata.get("kind") == CAN_FRAMES)

    def __getitem__(self, name: str) -> np.ndarray:
        """Values (N,) of a channel."""
        return self.channel(name).values

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def channel(self, name: str) -> Channel:
        """A channel by name; RecordingError names the closest where there is none."""
        try:
            return self.channels[name]
        except KeyError:
            close = difflib.get_close_matches(name, self.channels, n=1)
            hint = f"did you mean {close[0]}?" if close else f"it has {', '.join(self.channels)}"
            raise RecordingError(f"the recording has no channel {name}; {hint}") from None

    def matrix(self, names: Iterable[str]) -> np.ndarray:
        """(N, len(names)) values of several channels side by side."""
        return np.column_stack([self[name] for name in names])

    @property
    def rows(self) -> int:
        return int(self.channels["time"].values.size)

    @property
    def time(self) -> np.ndarray:
        """(N,) s."""
        return self.channels["time"].values

    @cached_property
    def sample_rate_Hz(self) -> float:
        """Rows per second, from the time channel; ticks per second where a run of the bench skipped some.

        Raises
        ------
        RecordingError
            Fewer than two rows, or rows that are not equally spaced (a lost row): the message names the first.
        """
        if self.rows < 2:
            raise RecordingError(f"{self.rows} rows have no sample rate; two or more do")
        steps = np.diff(self.time)
        step = float(np.median(steps))
        ticks = self.ticks
        uneven = np.flatnonzero(np.abs(steps - step * np.diff(ticks)) > UNEQUAL_STEP * step)
        if uneven.size:
            row = int(uneven[0])
            raise RecordingError(
                f"rows are not equally spaced: {steps[row]:.6g} s between rows {row} and {row + 1}, elsewhere {step:.6g} s"
                f" ({uneven.size} such steps); rows were lost"
            )
        return round(float(ticks[-1]) / float(self.time[-1] - self.time[0]), 6)

    @cached_property
    def ticks(self) -> np.ndarray:
        """(N,) tick of each row, from 0: the row number, but for runs of the bench, whose time counts ticks and leaves skipped ones out."""
        if self.rows < 2 or "bench" not in self.metadata:
            return np.arange(self.rows)
        return np.rint((self.time - self.time[0]) / np.median(np.diff(self.time))).astype(np.int64)

    @property
    def axes(self) -> tuple[str, ...]:
        """Axis names: the machine's where it is known, else those of the position or command channels."""
        known = self.metadata.get("machine", {}).get("axes")
        if known:
            return tuple(known)
        for prefix in ("position_", "command_", "link_position_"):
            found = tuple(name.removeprefix(prefix) for name in self.channels if name.startswith(prefix))
            if found:
                return found
        return ()

    @property
    def machine_hash(self) -> str:
        """SHA-256 of the machine file's text; "" where the machine is not known."""
        return str(self.metadata.get("machine", {}).get("hash", ""))

    @property
    def machine_text(self) -> str:
        """The machine file; "" where it is not known."""
        return str(self.metadata.get("machine", {}).get("text", ""))

    @property
    def experiment(self) -> dict[str, Any]:
        """The experiment's metadata; empty for a recording that comes from elsewhere."""
        return dict(self.metadata.get("experiment", {}))

    @property
    def period_slices(self) -> tuple[slice, ...]:
        """Rows of each whole period after the settling ones; a period in which ticks were skipped is none.

        Raises
        ------
        RecordingError
            Not a periodic experiment, or no whole period after settling.
        """
        samples = self.experiment.get("period_samples", 0)
        settle = self.experiment.get("settle_periods", 0)
        if not isinstance(samples, int) or not isinstance(settle, int) or samples <= 0 or settle < 0:
            raise RecordingError("not periodic: metadata experiment needs period_samples above 0 and settle_periods from 0, whole numbers")
        last = int(self.ticks[-1]) + 1 if self.rows else 0
        edges = np.searchsorted(self.ticks, np.arange(settle * samples, last + 1, samples)).tolist()
        whole = tuple(slice(a, b) for a, b in itertools.pairwise(edges) if b - a == samples)
        if not whole:
            raise RecordingError(f"{self.rows} rows hold no whole period of {samples} rows after {settle} settling ones")
        return whole

    def periods(self) -> tuple[Recording, ...]:
        """The recording split into its periods after settling, time running on."""
        return tuple(self.part(rows) for rows in self.period_slices)

    def in_periods(self, name: str) -> np.ndarray:
        """(P, period_samples) values of one channel, a row per period after settling."""
        return np.stack([self[name][rows] for rows in self.period_slices])

    def part(self, rows: slice | np.ndarray) -> Recording:
        """The same recording over some of its rows: a slice, or (N,) whether each is taken."""
        return Recording({name: Channel(channel.unit, channel.values[rows]) for name, channel in self.channels.items()}, self.metadata)

    def with_metadata(self, **tables: Any) -> Recording:
        """The same rows with metadata tables added or replaced."""
        return Recording(self.channels, {**self.metadata, **tables})

    def repeats(self, other: Recording) -> bool:
        """Whether both are the same experiment on the same machine: reference, excitation, start pose and machine hash are equal."""
        if not self.machine_hash or self.machine_hash != other.machine_hash or self.rows != other.rows:
            return False
        if self.experiment.get("start_pose") != other.experiment.get("start_pose"):
            return False
        driven = {name for name in (*self.channels, *other.channels) if name.startswith(("reference_", "excitation_"))}
        return bool(driven) and all(
            name in self and name in other and np.array_equal(self[name], other[name], equal_nan=True) for name in driven
        )


def _in_si(name: str, channel: Channel) -> Channel:
    unit, factor = unit_and_factor(name, channel.unit)
    if unit == channel.unit:
        return channel
    return Channel(unit, channel.values * factor)


def _check_time(time: np.ndarray, *, may_repeat: bool) -> None:
    holes = np.flatnonzero(~np.isfinite(time))
    if holes.size:
        raise RecordingError(f"time is missing in row {holes[0]}; every row has its time")
    steps = np.diff(time)
    wrong = np.flatnonzero(steps < 0.0 if may_repeat else steps <= 0.0)
    if wrong.size:
        row = int(wrong[0])
        raise RecordingError(f"time does not increase: {time[row]:.9g} s in row {row}, {time[row + 1]:.9g} s in row {row + 1}")
