"""A recording: one row per SYNC, named channels with units, and metadata on how it was made."""

from __future__ import annotations

import difflib
import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.files.frames import data_frame
from hil.files.toml_text import plain
from hil.recording.channels import check_name, unit_and_factor

if TYPE_CHECKING:
    import pandas as pd

UNEQUAL_STEP = 0.01
"""Largest deviation of a time step from the mean, as a share of it, that counts as equal sampling: clocks of real recorders jitter by about
1e-4 of a period, a lost row is a deviation of 1."""

CAN_FRAMES = "can_frames"
"""Metadata `kind` of a table of raw CAN frames, of which several may have the same time."""


@dataclass(frozen=True, eq=False)
class Channel:
    """The values of one signal.

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
        """Make the values read-only float64."""
        values = np.array(self.values, dtype=np.float64)
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    @property
    def missing(self) -> np.ndarray:
        """Rows (N,) bool in which no sample arrived."""
        missing: np.ndarray = np.isnan(self.values)
        return missing


@dataclass(frozen=True, eq=False)
class Recording:
    """Channels of equal length over one time, and metadata.

    Parameters
    ----------
    channels : mapping of str to Channel
        In file order; `time` is one of them, complete and increasing.
    metadata : mapping
        Tables of plain values (what TOML can hold): `machine` (name, hash, text, axes), `experiment`, `initial`, `software`; see
        docs/generated/file-formats.md.

    Raises
    ------
    RecordingError
        Time is missing or has a hole, channels differ in length, or a channel has a wrong unit.

    Examples
    --------
    Values are kept in SI, whatever they came in.

    >>> import hil
    >>> recording = hil.Recording({"time": hil.Channel("ms", [0.0, 5.0]), "position_roll": hil.Channel("deg", [0.0, 180.0])}, {})
    >>> recording.rows, float(recording["time"][1]), float(recording["position_roll"][1])
    (2, 0.005, 3.141592653589793)
    """

    channels: Mapping[str, Channel]
    metadata: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Convert to SI units and plain metadata, and check time and lengths."""
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
        """Return the values (N,) of a channel."""
        return self.channel(name).values

    def __contains__(self, name: str) -> bool:
        """Return whether there is a channel of this name."""
        return name in self.channels

    def channel(self, name: str) -> Channel:
        """Return a channel by name; RecordingError names the closest where there is none."""
        try:
            return self.channels[name]
        except KeyError:
            close = difflib.get_close_matches(name, self.channels, n=1)
            hint = f"did you mean {close[0]}?" if close else f"it has {', '.join(self.channels)}"
            raise RecordingError(f"the recording has no channel {name}; {hint}") from None

    def matrix(self, names: Iterable[str]) -> np.ndarray:
        """Return the values (N, len(names)) of several channels side by side."""
        return np.column_stack([self[name] for name in names])

    def frame(self) -> pd.DataFrame:
        """Return the channels as columns over time [s], a missing sample as NaN; their units are in `attrs["units"]`.

        Raises
        ------
        UnusableInputError
            Pandas, an extra, is not installed.
        """
        rest = {name: channel for name, channel in self.channels.items() if name != "time"}
        values, units = {name: each.values for name, each in rest.items()}, {name: each.unit for name, each in rest.items()}
        return data_frame(values, index=self.time, index_name="time", units=units)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.channels["time"].values.size)

    @property
    def time(self) -> np.ndarray:
        """Time (N,) [s]."""
        return self.channels["time"].values

    @cached_property
    def is_even(self) -> bool:
        """Whether all rows are equally spaced."""
        gaps = np.diff(self.time)
        return bool(np.all(np.abs(gaps - np.median(gaps)) < UNEQUAL_STEP * np.median(gaps)))

    @cached_property
    def sample_rate_Hz(self) -> float:
        """Rows per second, from the time channel; ticks per second where a run of the bench skipped some.

        Raises
        ------
        RecordingError
            There are fewer than two rows, or rows are not equally spaced (a lost row); the message names the first.
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
        """Tick (N,) of each row, from 0: the row number, except for runs of the bench, whose time leaves out skipped ticks."""
        if self.rows < 2 or "bench" not in self.metadata:
            return np.arange(self.rows)
        ticks: np.ndarray = np.rint((self.time - self.time[0]) / np.median(np.diff(self.time))).astype(np.int64)
        return ticks

    @property
    def axes(self) -> tuple[str, ...]:
        """Axis names: the machine's where it is known, otherwise those of the position or command channels."""
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
        """Text of the machine file; "" where it is not known."""
        return str(self.metadata.get("machine", {}).get("text", ""))

    @property
    def emulated(self) -> bool:
        """Whether the recording says that an emulator was the machine; one of another source does not say."""
        return self.metadata.get("emulated") is True

    @property
    def experiment(self) -> dict[str, Any]:
        """Metadata of the experiment; empty for a recording from another source."""
        return dict(self.metadata.get("experiment", {}))

    @property
    def period_slices(self) -> tuple[slice, ...]:
        """Rows of each complete period after the settling ones; a period in which ticks were skipped is not complete.

        Raises
        ------
        RecordingError
            The experiment is not periodic, or there is no complete period after settling.
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
        """Return the recording split into its periods after settling; time continues from one to the next."""
        return tuple(self.part(rows) for rows in self.period_slices)

    def in_periods(self, name: str) -> np.ndarray:
        """Return the values (P, period_samples) of one channel, a row per period after settling."""
        return np.stack([self[name][rows] for rows in self.period_slices])

    def part(self, rows: slice | np.ndarray) -> Recording:
        """Return the recording over some of its rows: a slice, or a mask (N,) bool."""
        return Recording({name: Channel(channel.unit, channel.values[rows]) for name, channel in self.channels.items()}, self.metadata)

    def with_metadata(self, **tables: object) -> Recording:
        """Return the same rows with metadata tables added or replaced."""
        return Recording(self.channels, {**self.metadata, **tables})

    def repeats(self, other: Recording) -> bool:
        """Return whether both are the same experiment on the same machine: equal reference, excitation, start pose and machine hash."""
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
