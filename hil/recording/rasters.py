"""Signals with times of their own, put onto the rows of one of them.

The rows are those of the raster whose rate is the machine's, without such a one those of the raster with most samples. Other signals
are interpolated linearly between their two neighbouring samples; counters and bit fields hold the last one. Before a signal's first
sample and after its last, and where samples were lost, nothing is known: the value is missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.errors import RecordingError
from hil.recording.channels import is_whole, unit_and_factor
from hil.recording.naming import Column, Columns, Target, named_channels
from hil.recording.recording import UNEQUAL_STEP, Channel
from hil.recording.stamps import part_straightened, rows_in_order, said_twice
from hil.recording.steps import LOST, SAME_RATE

if TYPE_CHECKING:
    from hil.machine.machine import Machine


def channels_on_one_raster(
    found: Columns, names: Mapping[str, Target], machine: Machine | None, path: Path, part: str = "", is_own: bool = False
) -> tuple[dict[str, Channel], list[str]]:
    """Return `time` and the channels that `names` makes of columns with times, all on one raster, and how they came onto it.

    Of a file that this project wrote (`is_own`) every row stands as it is: other people's logs alone hold several senders' rows.

    Raises
    ------
    RecordingError
        A name is not that of one column, a unit is wrong, times do not increase, or `time`, which the samples bring, is named.
    """
    if wrong := [name for name, wanted in names.items() if wanted.channel == "time"]:
        raise RecordingError(f"{path}: {wrong[0]} cannot be time: every signal of this format has its own; leave that name out")
    channels, sources = named_channels(found, names, machine, path)
    columns = {
        channel: Column(channels[channel].values, time_s=column.time_s, whole=column.whole or is_whole(channel))
        for channel, column in sources.items()
    }
    try:
        time_s, values, notes = on_one_raster(columns, machine, part, is_own)
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None
    return {"time": Channel("s", time_s)} | {name: Channel(channels[name].unit, values[name]) for name in channels}, notes


def channels_in_order(channels: dict[str, Channel], path: Path, part: str = "") -> tuple[dict[str, Channel], list[str]]:
    """Return the channels of one table in order of its time, and what was done; RecordingError where `stamps` refuses."""
    if "time" not in channels or len({channel.values.size for channel in channels.values()}) > 1:
        return channels, []  # what is wrong is told elsewhere
    time = channels["time"]
    channels = {**channels, "time": Channel("s", unit_and_factor("time", time.unit)[1] * time.values)}  # what is said of times is in s
    table = np.column_stack([channel.values for channel in channels.values()])
    try:
        table, notes = rows_in_order(table, list(channels), part=part)
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None
    return {name: Channel(channel.unit, table[:, place]) for place, (name, channel) in enumerate(channels.items())}, notes


def on_one_raster(
    columns: Mapping[str, Column], machine: Machine | None, part: str = "", is_own: bool = False
) -> tuple[np.ndarray, dict[str, np.ndarray], list[str]]:
    """Put columns with times onto one raster.

    Parameters
    ----------
    columns : mapping of str to Column
        At least one, each with times and samples.
    machine : Machine, optional
        Its rate chooses the raster.
    part : str
        As in `stamps.part_straightened`, of those signals that have several senders.
    is_own : bool
        Whether this project wrote them, in order of time.

    Returns
    -------
    time_s : ndarray, shape (N,)
    values : dict of str to ndarray, shape (N,)
    notes : list of str
        What was resampled, and how.

    Raises
    ------
    RecordingError
        A time is missing, or times go back in a way that `stamps` cannot repair.
    """
    columns, notes = (columns, []) if is_own else _straight(columns, part)
    rasters = _rasters(columns)
    base = _base([times(columns[names[0]]) for names in rasters], [len(names) for names in rasters], machine) if rasters[1:] else 0
    time_s = times(columns[rasters[base][0]])
    values: dict[str, np.ndarray] = {name: columns[name].values for name in rasters[base]}
    for place, names in enumerate(rasters):
        if place != base:
            values |= {name: resampled(columns[name], time_s) for name in names}
            own_Hz = rate_Hz(times(columns[names[0]]))
            rates = f"{own_Hz:.4g} Hz" if own_Hz else "single samples"
            how = "held" if all(columns[name].whole for name in names) else "interpolated"
            how += ", whole numbers held" if how == "interpolated" and any(columns[name].whole for name in names) else ""
            notes.append(f"{', '.join(names)} ({rates}) put onto the rows of {rasters[base][0]} ({rate_Hz(time_s):.4g} Hz): {how}")
    return time_s, {name: values[name] for name in columns}, notes


def _straight(columns: Mapping[str, Column], part: str) -> tuple[dict[str, Column], list[str]]:
    """Return the columns in order of time, those that share their times together, and what was done."""
    straight: dict[str, Column] = dict(columns)
    notes: list[str] = []
    refusals: list[str] = []
    rasters = _rasters(columns)
    for names in rasters:
        own = times(columns[names[0]])
        if not np.isfinite(own).all():
            raise RecordingError(f"{names[0]}: sample {int(np.argmin(np.isfinite(own)))} has no time")
        try:
            values = np.column_stack([columns[name].values.astype(np.float64) for name in names])
            made = part_straightened(own, values, names, "sample", part=part)
        except RecordingError as problem:
            if not part or len(refusals) == len(rasters) - 1:
                raise RecordingError(f"{names[0]}: {problem}") from None
            refusals.append(str(problem))
            made = part_straightened(own, values, names, "sample")
        notes += [f"{', '.join(names)}: {note}" for note in [*made.notes, *said_twice(made.twice)]]
        straight |= {name: replace(columns[name], values=columns[name].values[made.places], time_s=made.time_s) for name in names}
    return straight, notes


def times(column: Column) -> np.ndarray:
    """Return the times (N,) [s] of a column that has them."""
    assert column.time_s is not None
    return column.time_s


def rate_Hz(time_s: np.ndarray) -> float:
    """Return the usual rate [Hz] of samples; 0 of fewer than two."""
    return 1.0 / float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0


def resampled(column: Column, time_s: np.ndarray) -> np.ndarray:
    """Return a column's values (N,) at other times [s], NaN where they are not known."""
    own, values = times(column), column.values.astype(np.float64)
    before = np.searchsorted(own, time_s, side="right") - 1
    known = before >= 0
    before = np.maximum(before, 0)
    after = np.minimum(before + 1, own.size - 1)
    usual = float(np.median(np.diff(own))) if own.size > 1 else math.inf
    at_sample = own[before] == time_s
    if column.whole:
        known &= time_s - own[before] <= LOST * usual
        return np.where(known, values[before], np.nan)
    gap = own[after] - own[before]
    known &= at_sample | ((after > before) & (gap <= LOST * usual))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(at_sample, 0.0, (time_s - own[before]) / gap)
        between = np.where(at_sample, values[before], (1.0 - share) * values[before] + share * values[after])
    return np.where(known, between, np.nan)


def _rasters(columns: Mapping[str, Column]) -> list[list[str]]:
    """Return the names of columns that share their times, a list each."""
    rasters: list[list[str]] = []
    for name, column in columns.items():
        for names in rasters:
            if _same(times(columns[names[0]]), times(column)):
                names.append(name)
                break
        else:
            rasters.append([name])
    return rasters


def _same(first: np.ndarray, second: np.ndarray) -> bool:
    if first is second:
        return True
    if first.shape != second.shape:
        return False
    tolerance = UNEQUAL_STEP * float(np.median(np.diff(first))) if first.size > 1 else 0.0
    return not np.any(np.abs(first - second) > tolerance)


def _base(rasters: Sequence[np.ndarray], widths: Sequence[int], machine: Machine | None) -> int:
    """Return the place of the raster that gives the rows."""
    rates = [rate_Hz(raster) for raster in rasters]
    if machine is not None:
        fit = [place for place, own in enumerate(rates) if abs(own - machine.sample_rate_Hz) <= SAME_RATE * machine.sample_rate_Hz]
        if fit:
            return max(fit, key=lambda place: (widths[place], rasters[place].size))
    return max(range(len(rasters)), key=lambda place: (rasters[place].size, widths[place]))
