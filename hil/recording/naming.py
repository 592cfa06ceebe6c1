"""Names of other tools' files: which of their columns is which channel, in which unit and with which factor."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hil.errors import RecordingError
from hil.files.regular import check_regular
from hil.recording.channels import (
    COUNTS,
    OF_THE_MACHINE,
    PERCENT,
    PERMILLE,
    SI_OF,
    TIME,
    check_name,
    is_unit,
    kind_of,
    spelled,
    unit_and_factor,
)
from hil.recording.recording import Channel
from hil.recording.said import listed, printable
from hil.recording.steps import SAME_RATE, usual_step
from hil.recording.unit_in_name import in_brackets, unit_in_name
from hil.recording.warning import RecordingWarning

if TYPE_CHECKING:
    from hil.machine.machine import Machine

MOST_MAP_BYTES = 2**20
"""Of a file of names: ten thousand names have fewer."""

FIXED_UNITS = {
    "time": "s",
    **dict.fromkeys(("imu_x", "imu_y", "imu_z"), "m/s^2"),
    **dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), "rad/s"),
    "imu_time": "s",
    "imu_counter": "",
    "sync_lateness": "s",
    "work_time": "s",
    "exposure_id": "",
}
"""Units of channels that belong to no axis."""

_AXIS_UNITS = {"statusword": "", "temperature": "degC", "data_age": "s"}
_EFFORTS = ("excitation", "feedforward", "command", "current", "effort")
_POSITIONS = ("reference", "reference_raw", "position", "link_position")
_TARGET = re.compile(r"\s*(?P<channel>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")
_KEYS = ("channel", "unit", "scale", "offset")


class Target(NamedTuple):
    """What a column of a file becomes: `channel = scale * column + offset`, in `unit`; None is the file's own unit, or the machine's."""

    channel: str
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Column:
    """One signal of another tool's file.

    Parameters
    ----------
    values : ndarray, shape (N,)
        NaN where a sample is missing.
    unit : str, optional
        None where the file gives none.
    time_s : ndarray, shape (N,), optional
        Times of its samples, where signals have times of their own.
    whole : bool
        A counter or a bit field, between whose values there is nothing.
    """

    values: np.ndarray
    unit: str | None = None
    time_s: np.ndarray | None = None
    whole: bool = False


@dataclass(frozen=True)
class Columns:
    """What a file holds.

    Parameters
    ----------
    columns : mapping
        Name -> column, each name of one column only.
    several : mapping
        A name that stands for several columns -> their names.
    others : mapping
        Name of what is no column of numbers -> what it is.
    notes : sequence of str
        What of the columns could not be taken.
    """

    columns: Mapping[str, Column]
    several: Mapping[str, Sequence[str]] = field(default_factory=dict)
    others: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()


def target(text: str, where: str) -> Target:
    """Read `CHANNEL` or `CHANNEL [unit]`; `where` begins the error."""
    if not is_header_cell(text):
        raise RecordingError(f"{where}: {text!r} is not `CHANNEL` or `CHANNEL [unit]`, such as `position_roll [deg]`")
    name, unit = header_name(text)
    return Target(check_name(name), unit)


def is_header_cell(text: str) -> bool:
    """Return whether a text is `name` or `name [unit]`."""
    match = _TARGET.fullmatch(text)
    return match is not None and bool(match["channel"])


def header_name(cell: str) -> tuple[str, str | None]:
    """Return name and unit of `name [unit]`; the whole text and no unit where it is something else."""
    match = _TARGET.fullmatch(cell)
    if match is None or not match["channel"]:
        return cell.strip(), None
    return match["channel"], None if match["unit"] is None else match["unit"].strip()


def read_names(path: Path) -> dict[str, Target]:
    """Read a file of names: TOML with a table `channels`, name in the file -> `"CHANNEL [unit]"` or a table.

    Such a table has `channel` and, if need be, `unit`, `scale` and `offset`.

    Raises
    ------
    RecordingError
        The file is no such table; the message names the entry.
    """
    check_regular(path, RecordingError, MOST_MAP_BYTES)
    try:
        document = tomllib.loads(path.read_bytes().decode())
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as problem:
        raise RecordingError(f"{path}: no TOML: {str(problem).partition(chr(10))[0]}") from None
    entries = document.pop("channels", None)
    if not isinstance(entries, dict) or not entries or document:
        what = f"key {next(iter(document))}" if document else "no table [channels]"
        raise RecordingError(f'{path}: {what}; a file of names is a table [channels] of lines such as "qd" = "position_roll [deg]"')
    return {name: _entry(entry, f"{path}: channels.{name}") for name, entry in entries.items()}


def _entry(entry: object, where: str) -> Target:
    if isinstance(entry, str):
        return target(entry, where)
    if not isinstance(entry, dict) or not isinstance(entry.get("channel"), str):
        raise RecordingError(f'{where}: must be "CHANNEL [unit]" or a table with channel = "CHANNEL", and unit, scale, offset if need be')
    if unknown := [key for key in entry if key not in _KEYS]:
        raise RecordingError(f"{where}: unknown key {unknown[0]}; {', '.join(_KEYS)} are known")
    named = target(entry["channel"], where)
    unit = entry.get("unit", named.unit)
    if unit is not None and not isinstance(unit, str):
        raise RecordingError(f'{where}: unit = {unit!r}: must be a text such as "deg"')
    scale, offset = entry.get("scale", 1.0), entry.get("offset", 0.0)
    for key, value in (("scale", scale), ("offset", offset)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or (key == "scale" and value == 0):
            raise RecordingError(f"{where}: {key} = {value!r}: must be a finite number{' other than 0' if key == 'scale' else ''}")
    return Target(named.channel, unit, float(scale), float(offset))


def picked(found: Columns, names: Mapping[str, Target], path: Path) -> None:
    """Check that each name is that of one column, and each channel named once; RecordingError lists the names that would be right."""
    for name in names:
        if name in found.columns:
            continue
        if name in found.several:
            raise RecordingError(f"{path}: {name} is no vector of numbers but stands for several; name one: {listed(found.several[name])}")
        if name in found.others:
            raise RecordingError(f"{path}: variable {name} is no vector of numbers but {found.others[name]}")
        raise RecordingError(f"{path}: no variable {name}; {_instead(name, [*found.columns, *found.others])}")
    channels: dict[str, str] = {}
    for name, wanted in names.items():
        if wanted.channel in channels:
            raise RecordingError(f"{path}: both {channels[wanted.channel]} and {name} are to be {wanted.channel}; a channel has one source")
        channels[wanted.channel] = name


def named_channels(
    found: Columns, names: Mapping[str, Target], machine: Machine | None, path: Path
) -> tuple[dict[str, Channel], dict[str, Column]]:
    """Return the channels that `names` makes of a file's columns, and the column of each.

    A unit comes from the name, else from the file, else from the machine.

    Raises
    ------
    RecordingError
        As in `picked`; or a channel has a wrong unit, or none is known.
    """
    picked(found, names, path)
    channels: dict[str, Channel] = {}
    sources: dict[str, Column] = {}
    for name, wanted in names.items():
        column = found.columns[name]
        wanted = with_unit(wanted, column.unit, machine, path, name)
        values = column.values.astype(np.float64)
        if wanted.unit is None:
            wanted = timed(wanted, values, machine, path, name)
        unit = wanted.unit or ""
        if (wanted.scale, wanted.offset) != (1.0, 0.0):
            values = wanted.scale * values + wanted.offset
        channels[wanted.channel] = Channel(unit, values)
        sources[wanted.channel] = column
    return channels, sources


def named_or_own(
    found: Columns, names: Mapping[str, Target], path: Path, machine: Machine | None = None
) -> tuple[dict[str, Target], list[str]]:
    """Return `names` and, under their own names, the columns that they leave out; and which of these are no channel.

    For files whose columns have units.

    Raises
    ------
    RecordingError
        As in `picked`; a name stands for several columns and `names` tells none of them apart; or, where there are no `names` that could
        mend it, a column has a channel's name and not its unit.
    """
    picked(found, names, path)
    for name, meant in found.several.items():
        if not any(one in names for one in meant):
            raise RecordingError(f"{path}: channel {name} is in it twice; say with --map which is which: {listed(meant)}")
    wanted = dict(names)
    taken = {one.channel for one in names.values()}
    not_taken = []
    for name, column in found.columns.items():
        if name in names:
            continue
        try:
            if name in taken:
                raise RecordingError(f"another one is to be {name}")
            with_unit(Target(check_name(name), column.unit or ""), None, machine, path)
            wanted[name] = Target(name, column.unit or "")
        except RecordingError as problem:
            if not names:
                raise RecordingError(f"{path}: {problem}") from None
            not_taken.append(f"{name}: {problem}")
    if not wanted:
        why = listed(list(dict.fromkeys(found.others.values())))
        raise RecordingError(f"{path}: holds no numeric signals with a time{f'; others: {why}' if why else ''}")
    return wanted, not_taken


def with_unit(wanted: Target, in_file: str | None, machine: Machine | None, path: Path, name: str = "") -> Target:
    """Return what a column becomes, with its unit: as it is given, else from the file, else from the column's name, else from the machine.

    Counts become what the machine file's encoder counts, parts of the rated effort become that effort; that and a unit by name are said in
    a warning. The unit of times that nothing tells is left to `timed`.

    Raises
    ------
    RecordingError
        The channel cannot be measured in that unit; the message names those that it can, and the factor of a file of names.
    """
    channel = wanted.channel
    unit = wanted.unit if wanted.unit is not None else in_file
    if unit is None and name and (unit := _named_unit(name, channel, machine)) is not None:
        warnings.warn(f"{path}: {printable(name)} is taken in {unit}, by its name", RecordingWarning, stacklevel=2)
    if unit is None and machine is not None and channel != "time":
        unit = machine_unit(channel, machine, path)
    if unit is None and machine is not None:
        return wanted
    of_machine = spelled(unit or "", OF_THE_MACHINE)
    if of_machine in OF_THE_MACHINE and (size := _size(channel, of_machine, machine)) is not None:
        unit, factor = size
        words = f"{channel}: [{of_machine}] taken as {factor:.6g} {unit} each, by the machine file"
        warnings.warn(f"{path}: {words}", RecordingWarning, stacklevel=2)
        return Target(channel, unit, wanted.scale * factor, wanted.offset * factor)
    try:
        unit_and_factor(channel, unit or "", _like(channel, machine, path))
    except RecordingError as problem:
        if not unit:
            raise RecordingError(f"{problem}; say which with --map '{name or channel}={channel} [UNIT]'") from None
        way_out = f'"NAME" = {{ channel = "{channel}", unit = "...", scale = ... }} (--map FILE)'
        raise RecordingError(f"{problem}; a file of names takes any other with its scale: {way_out}") from None
    return wanted._replace(unit=unit or "")


def timed(wanted: Target, values: np.ndarray, machine: Machine | None, path: Path, name: str) -> Target:
    """Return the target of times (N,) of which nothing tells the unit: seconds, unless they have the machine's rate in another unit.

    That is said in a warning, and where the machine's rate is nearer in another unit.
    """
    known = values[np.isfinite(values)]
    step = usual_step(known)
    if machine is None or not step or wanted.scale != 1.0:
        return wanted._replace(unit="s")
    steps = [one for one in (step, float(known[-1] - known[0]) / (known.size - 1)) if one > 0.0]  # whole milliseconds may have either
    off = {
        unit: min(abs(math.log(factor * one * machine.sample_rate_Hz)) for one in steps) for unit, factor in TIME.items() if unit != "min"
    }
    unit = min(off, key=lambda one: off[one])
    words = ""
    if unit != "s" and off[unit] > SAME_RATE:
        due = f"the machine in steps of {1.0 / machine.sample_rate_Hz:.6g} s"
        words = f"is taken in s, so it goes in steps of {step:.6g} s, {due}; --map '{name}=time [{unit}]' takes it in {unit}"
        unit = "s"
    elif unit != "s":
        words = f"is taken in {unit}: so it has the {machine.sample_rate_Hz:.6g} Hz of machine {machine.name}"
    if words:
        warnings.warn(f"{path}: {printable(name)} has no unit and {words}", RecordingWarning, stacklevel=2)
    return wanted._replace(unit=unit)


def own_target(name: str, machine: Machine) -> Target | None:
    """Return the channel whose name a column has, with or without a unit in it; None for others."""
    if is_channel(name, machine):
        return Target(name)
    for channel in (*FIXED_UNITS, *(f"{quantity}_{axis}" for axis in machine.axes for quantity in (*_POSITIONS, *_EFFORTS, "speed"))):
        found = unit_in_name(name, _units(channel, machine))
        if found is not None and (found[0] == channel or (channel, found[0].lower()) == ("time", "time")):
            return Target(channel, found[1])
    return None


def _named_unit(name: str, channel: str, machine: Machine | None) -> str | None:
    """Return the unit in a column's name: one in brackets, whatever it is, or one that the channel can have."""
    if found := unit_in_name(name, _units(channel, machine)):
        return found[1]
    bracketed = in_brackets(name)
    return bracketed[1] if bracketed is not None and is_unit(bracketed[1]) else None


def _units(channel: str, machine: Machine | None) -> list[str]:
    """Return the units that a channel can have, those among them whose size the machine file says."""
    kind = kind_of(channel)
    like = _like(channel, machine, "")
    units = [] if kind is None else [unit for unit in kind.units if unit and (not like or SI_OF.get(unit, unit) == like)]
    return units + [unit for unit in OF_THE_MACHINE if _size(channel, unit, machine) is not None]


def _like(channel: str, machine: Machine | None, path: Path | str) -> str:
    """Return the unit in memory of an angle or a length by the machine's axis; "" for other channels, which may have several."""
    axis = None if machine is None else machine.axis_of_channel(channel)
    if machine is None or axis is None or channel.removesuffix(f"_{axis}") not in (*_POSITIONS, "speed"):
        return ""
    return machine_unit(channel, machine, path)


def _size(channel: str, unit: str, machine: Machine | None) -> tuple[str, float] | None:
    """Return unit and size of a count or a part of the rated effort; None where the machine file does not say it for this channel."""
    axis = None if machine is None else machine.axis_of_channel(channel)
    if machine is None or axis is None:
        return None
    quantity, units = channel.removesuffix(f"_{axis}"), machine.units[machine.axis_index(axis)]
    if unit in (PERCENT, PERMILLE):
        rated = next((drive.rated for drive in machine.plant.drives if drive.axis == axis), 0.0)
        fits = rated > 0.0 and quantity in _EFFORTS and not (quantity == "current" and units.effort != "A")
        return (units.effort, rated / (100.0 if unit == PERCENT else 1000.0)) if fits else None
    if quantity not in ((*_POSITIONS, "command") if unit == COUNTS else ("speed",)):
        return None
    source = f"{'link_position' if quantity == 'link_position' else 'position'}_{axis}"
    resolution = next((encoder.resolution for encoder in machine.plant.encoders if encoder.channel == source), 0.0)
    return (units.position if unit == COUNTS else f"{units.position}/s", resolution) if resolution > 0.0 else None


def machine_unit(channel: str, machine: Machine, path: Path | str) -> str:
    """Return the unit of a channel of this machine; `path` is how messages call the file."""
    if channel in FIXED_UNITS:
        return FIXED_UNITS[channel]
    axis = machine.axis_of_channel(channel)
    if axis is None:
        raise RecordingError(f"{path}: {channel} is no channel of machine {machine.name} with axes {', '.join(machine.axes)}")
    units, quantity = machine.units[machine.axis_index(axis)], channel.removesuffix(f"_{axis}")
    if quantity in _AXIS_UNITS:
        return _AXIS_UNITS[quantity]
    if quantity == "speed":
        return f"{units.position}/s"
    return units.position if quantity in _POSITIONS else units.effort


def is_channel(name: str, machine: Machine) -> bool:
    """Return whether a name is that of a channel of this machine, or of no axis."""
    if name in FIXED_UNITS:
        return True
    axis = machine.axis_of_channel(name)
    return axis is not None and kind_of(name) is not None and kind_of(name.removesuffix(axis) + "x") is not None


def _instead(name: str, known: Iterable[str]) -> str:
    known = [printable(one) for one in known]
    close = difflib.get_close_matches(name, known, n=3)
    return f"did you mean {' or '.join(close)}?" if close else f"it has {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}"
