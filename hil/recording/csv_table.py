"""CSV recordings: a header of `name [unit]` cells, a row per SYNC, empty cells for missing samples, metadata in a `.toml` beside it.

Files of other tools, which have no `.toml` beside them or other separators than commas, are read as `csv_dialect` finds them.
"""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.files.atomic import write_atomically
from hil.files.regular import check_regular
from hil.recording.can_frames import counted
from hil.recording.channels import check_name, is_whole, unit_and_factor
from hil.recording.csv_dialect import Clock, Numbers, decoded, is_number, laid_out, row_of_units
from hil.recording.csv_labels import Lines, of_one_part
from hil.recording.metadata import machine_table, metadata_text, parse_metadata
from hil.recording.naming import Column, Columns, Target, header_name, is_header_cell, own_target, picked, timed, with_unit
from hil.recording.recording import CAN_FRAMES, Channel, Recording
from hil.recording.said import listed, source_table
from hil.recording.stamps import rows_in_order

if TYPE_CHECKING:
    from _csv import Reader

    from hil.machine.machine import Machine

_TAKEN_BY_NAME = "where --map names columns, others that hold no numbers are left out"


def metadata_path(path: Path) -> Path:
    """Return the path of a CSV recording's metadata."""
    return path.with_suffix(".toml")


def write_csv(recording: Recording, path: Path) -> None:
    """Write `path` and the `.toml` of the same name; numbers read back bit for bit.

    Raises
    ------
    RecordingError
        The `.toml` exists and is no recording's metadata (but a machine file, for example), or a file cannot be written.
    """
    beside = metadata_path(path)
    if beside.exists():
        _read_metadata(beside, f"{path} would put its metadata there: choose another name")
    metadata = metadata_text({**recording.metadata, "rows": recording.rows})
    write_atomically({beside: metadata.encode(), path: csv_text(recording).encode()})


def csv_text(recording: Recording) -> str:
    """Return the CSV text of a recording."""
    header = ",".join(f"{name} [{channel.unit}]" if channel.unit else name for name, channel in recording.channels.items())
    columns = [_cells(name, channel.values) for name, channel in recording.channels.items()]
    return "\n".join([header, *map(",".join, zip(*columns, strict=True))]) + "\n"


def read_csv(path: Path, machine: Machine | None = None, names: Mapping[str, Target] | None = None, part: str = "") -> Recording:
    """Read a CSV recording.

    Parameters
    ----------
    path : Path
    machine : Machine, optional
        Replaces the metadata where there is no `.toml` of the same name.
    names : mapping, optional
        Name in the header -> channel. Columns that it does not name keep theirs.
    part : str
        Of lines of several senders those to take: `joint@roll` by the column that says whose a line is, else as in `stamps`.

    Raises
    ------
    RecordingError
        A ragged row, a cell that is no number, a hole in time, time that does not increase, a unit that the channel cannot have, a channel
        twice, fewer rows than the metadata say, or neither metadata nor machine; the message names the line.
    """
    metadata = _metadata_of(path, machine)
    text, notes = _read_text(path, strict=metadata_path(path).exists())
    rows = metadata.pop("rows", None)
    if rows is not None and not text.endswith("\n"):
        raise RecordingError(f"{path}: line {text.count(chr(10)) + 1}: the last line is not complete; the file was cut off")
    table = _parse(path, text, names or {}, machine, part="" if part[:1] == "@" else part)
    values, lines, notes, targets = table.values, table.lines, [*notes, *table.notes], list(table.targets)
    if rows is not None and rows != len(values):
        beside = metadata_path(path).name
        raise RecordingError(f"{path}: {len(values)} rows, but {beside} says rows = {rows}; the file was cut off or edited")
    if not metadata_path(path).exists():
        try:
            own, names_of = part if part[:1] == "@" else "", [one.channel for one in targets]
            place = names_of.index("time")
            factor = unit_and_factor("time", table.targets[place].unit or "s")[1]
            targets[place] = targets[place]._replace(unit="s")  # what is said of times is in s
            values[:, place] *= factor
            values, order = rows_in_order(values, names_of, "line", lines, own, table.heads)
        except RecordingError as problem:
            raise RecordingError(f"{path}: {problem}") from None
        notes = [*notes, *order]
    channels = {one.channel: Channel(one.unit or "", values[:, column]) for column, one in enumerate(targets)}
    _check_time(path, channels["time"].values, lines, may_repeat=metadata.get("kind") == CAN_FRAMES)
    if names or table.not_taken or notes:
        renamed = {name: one.channel for name, one in (names or {}).items()}
        metadata["source"] = source_table(path, table.not_taken, notes, renamed)
    try:
        return Recording(channels, metadata)
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _cells(name: str, values: np.ndarray) -> list[str]:
    if is_whole(name):
        return ["" if value != value else str(int(value)) if value.is_integer() else repr(value) for value in values.tolist()]
    return ["" if value != value else repr(value) for value in values.tolist()]


def _read_text(path: Path, *, strict: bool = True) -> tuple[str, list[str]]:
    check_regular(path, RecordingError)
    try:
        return decoded(path.read_bytes(), strict=strict)
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror or problem}") from None
    except UnicodeDecodeError as problem:
        raise RecordingError(f"{path}: no UTF-8 text: byte {problem.start} is 0x{problem.object[problem.start]:02X}") from None


def _metadata_of(path: Path, machine: Machine | None) -> dict[str, Any]:
    beside = metadata_path(path)
    if beside.exists():
        metadata = _read_metadata(beside, "")
        if machine is not None:
            metadata.setdefault("machine", machine_table(machine))
        return metadata
    if machine is None:
        raise RecordingError(f"{path}: its metadata {beside.name} is not beside it; name the machine with --machine")
    return {"machine": machine_table(machine)}


def _read_metadata(beside: Path, reason: str) -> dict[str, Any]:
    try:
        return parse_metadata(_read_text(beside)[0], str(beside))
    except RecordingError as problem:
        raise RecordingError(f"{problem}; {reason}" if reason else str(problem)) from None


@dataclass(frozen=True)
class _Table:
    """What a file holds."""

    targets: Sequence[Target]  # of every column that is taken
    values: np.ndarray  # (rows, columns taken)
    lines: list[int]  # of the file, of each row
    heads: list[int]  # lines at which the header stands again
    not_taken: Sequence[str]
    notes: Sequence[str]


def _parse(
    path: Path, text: str, names: Mapping[str, Target], machine: Machine | None, thousands: Iterable[str] = (), part: str = ""
) -> _Table:
    """Read a text; `thousands` are marks between thousands that are known, `part` is as in `csv_labels`."""
    layout = laid_out(text, strict=metadata_path(path).exists())
    strict = layout.delimiter == "," and metadata_path(path).exists()
    reader = csv.reader(io.StringIO(layout.text, newline=""), strict=True, delimiter=layout.delimiter)
    records = _records(path, reader)
    header = next(records, None)
    if header is None:
        raise RecordingError(f"{path}: line 1: empty; a header of `name [unit]` cells is first")
    first = next(records, None)
    first_line = reader.line_num
    units: list[str] | None = None
    if not strict and first is not None:
        header, first, units = _foreign_head(header, first)
    targets, not_taken = _targets(path, header, units, names, machine)
    named = {one.channel for one in names.values()}
    time_place = next((place for place, one in enumerate(targets) if one is not None and one.channel == "time"), None)
    cells_of = _Cells(strict, time_place, Numbers(set(thousands)))
    table: Lines = []
    again: list[int] = []  # lines of the header
    for cells in itertools.chain([] if first is None else [first], records):
        line = layout.skipped + (reader.line_num if cells is not first else first_line)
        if not cells:
            continue
        if len(cells) == len(header) + 1 and not strict and not cells[-1].strip():  # a delimiter behind each row, as spreadsheets write it
            cells.pop()
        if len(cells) != len(header):
            raise RecordingError(f"{path}: line {line}: {len(cells)} cells, the header has {len(header)}")
        if not strict and cells == header:
            again.append(line)
        else:
            table.append((line, cells))
    notes = [f"the header stands there again in {counted(len(again), 'line')}, first line {again[0]}: passed over"] if again else []
    if not strict:
        try:
            table, label, taken = of_one_part(header, table, time_place, {name for name in names if name in header}, part)
        except RecordingError as problem:
            raise RecordingError(f"{path}: {problem}") from None
        notes += taken
        targets = [None if place == label else one for place, one in enumerate(targets)]
    places = [place for place, one in enumerate(targets) if one is not None]
    rows: list[list[float]] = []
    lines: list[int] = []
    either: dict[str, int] = {}  # mark of decimals or of thousands -> line of the first
    no_numbers: dict[int, str] = {}  # place of a column that may be left out -> its first cell that is no number
    for line, cells in table:
        row = []
        for place in places:
            try:
                row.append(cells_of.number(cells[place], place))
            except ValueError:
                one, cell = targets[place], cells[place].strip()
                if one is None or not named or one.channel in {"time", *named}:
                    way_out = "" if strict or named or (one and one.channel == "time") else f"; {_TAKEN_BY_NAME}"
                    raise RecordingError(f"{path}: line {line}: {header[place]} = {cell!r} is no number{way_out}") from None
                row.append(np.nan)
                no_numbers.setdefault(place, f"{header[place]}: line {line}: {cell[:40]!r} is no number")
        try:
            cells_of.numbers.check()
        except RecordingError as problem:
            raise RecordingError(f"{path}: line {line}: {problem}") from None
        if len(either) < len(cells_of.numbers.either):
            either = dict.fromkeys(cells_of.numbers.either, line) | either
        rows.append(row)
        lines.append(line)
    if not rows:
        raise RecordingError(f"{path}: line 1: a header and no rows")
    try:
        found = cells_of.numbers.thousands(layout.delimiter)
    except RecordingError as problem:
        raise RecordingError(f"{path}: line {min(either.values())}: {problem}") from None
    if found:
        return _parse(path, text, names, machine, found, part)
    kept = [one for place, one in enumerate(targets) if one is not None and place not in no_numbers]
    values = np.array(rows)[:, [place not in no_numbers for place in places]]
    for column, one in enumerate(kept):
        if one.unit is None:  # of times, where nothing says it
            named_so = header_name(header[places[column]])[0]
            kept[column] = one = one._replace(unit="s") if cells_of.is_clock else timed(one, values[:, column], machine, path, named_so)
        if (one.scale, one.offset) != (1.0, 0.0):
            values[:, column] = one.scale * values[:, column] + one.offset
    return _Table(kept, values, lines, again, [*not_taken, *no_numbers.values()], notes)


class _Cells:
    """Reads the cells of a table; a column of times of day is known by its first cell."""

    def __init__(self, strict: bool, time_place: int | None, numbers: Numbers) -> None:
        self.numbers = numbers
        self._strict = strict
        self._time_place = time_place
        self._clock: Clock | None = None

    @property
    def is_clock(self) -> bool:
        """Whether times are times of day."""
        return self._clock is not None

    def number(self, cell: str, place: int) -> float:
        """Return a cell's number, NaN where it is missing; ValueError if it is none."""
        if self._strict:
            return float(cell) if cell else np.nan
        if place == self._time_place and self._clock is not None:
            return self._clock.seconds(cell)
        try:
            return self.numbers.number(cell)
        except ValueError:
            if place != self._time_place:
                raise
        clock = Clock()
        seconds = clock.seconds(cell)
        self._clock = clock
        return seconds


def _foreign_head(header: list[str], first: list[str]) -> tuple[list[str], list[str] | None, list[str] | None]:
    """Return the header without and with what tools add to it, the first row of numbers, and the units of a row of units."""
    if len(header) > 1 and not header[-1].strip() and len(first) != len(header) + 1:
        header = header[:-1]  # a delimiter behind each row
        first = first[:-1] if len(first) == len(header) + 1 and not first[-1].strip() else first
    if len(first) == len(header) + 1 and first[-1].strip() and (first[0].strip() == "1" or not is_number(first[0])):
        header = ["", *header]  # rows have names, of which the header says nothing
    units = row_of_units(first) if len(first) == len(header) else None
    return header, first if units is None else None, units


def _records(path: Path, reader: Reader) -> Iterator[list[str]]:
    """Yield the reader's records; its errors become RecordingError."""
    try:
        yield from reader
    except csv.Error as problem:
        raise RecordingError(f"{path}: line {reader.line_num}: {problem}") from None


def _targets(
    path: Path, cells: list[str], units: Sequence[str] | None, names: Mapping[str, Target], machine: Machine | None
) -> tuple[list[Target | None], list[str]]:
    """Return what each column becomes, and which columns are not taken."""
    foreign = [header_name(cell) for cell in cells]
    if units is not None:
        foreign = [(name, below if unit is None else unit) for (name, unit), below in zip(foreign, units, strict=True)]
    columns: dict[str, Column] = {}
    several: dict[str, list[str]] = {}
    for place, (cell, (name, unit)) in enumerate(zip(cells, foreign, strict=True)):
        if name in names and name in columns:
            several[name] = [f"column {place + 1}, {cell}"]
        columns[cell.strip() if cell.strip() in names else name] = Column(np.empty(0), unit)
    picked(Columns(columns, several), names, path)
    targets: list[Target | None] = []
    not_taken: list[str] = []
    taken = {one.channel for one in names.values()}
    for cell, (name, unit) in zip(cells, foreign, strict=True):
        if not cell.strip() and len(cells) > 1 and not metadata_path(path).exists():
            targets.append(None)
            not_taken.append("column without a name")
            continue
        try:
            if one := names.get(cell.strip(), names.get(name)):
                targets.append(with_unit(one, unit, machine, path, name))
            else:
                own = _own(cell, name, unit, taken, machine, named=bool(names), strict=metadata_path(path).exists())
                targets.append(with_unit(own, None, machine, path, name))
                taken.add(own.channel)
        except RecordingError as problem:
            if not names or cell.strip() in names or name in names:
                said = str(problem)
                raise RecordingError(said if said.startswith(str(path)) else f"{path}: line 1: {said}") from None
            targets.append(None)
            not_taken.append(f"{name or 'column without a name'}: {problem}")
    if "time" not in {one.channel for one in targets if one is not None}:
        instead = f"say which is with --map 'NAME=time [s]': {listed([name for name, _ in foreign if name])}"
        raise RecordingError(f"{path}: line 1: no column `time [s]`; {instead}")
    return targets, not_taken


def _own(cell: str, name: str, unit: str | None, taken: set[str], machine: Machine | None, *, named: bool, strict: bool) -> Target:
    """Return the target of a column that keeps its name, or is a channel of the machine with a unit in its name."""
    own = own_target(name, machine) if unit is None and machine is not None and not strict else None
    is_own = own is not None and (own.unit is not None or own.channel == "time")
    if own is None and not is_header_cell(cell):
        raise RecordingError(f"header cell {cell!r} is not `name [unit]`")
    channel = own.channel if own is not None and is_own else check_name(name)
    if channel in taken:
        raise RecordingError(f"another column is to be {channel}" if named else f"channel {channel} stands there twice")
    return Target(channel, None if is_own else unit or "")


def _check_time(path: Path, time: np.ndarray, lines: list[int], *, may_repeat: bool) -> None:
    holes = np.flatnonzero(~np.isfinite(time))
    if holes.size:
        raise RecordingError(f"{path}: line {lines[holes[0]]}: time is missing; every row has its time")
    steps = np.diff(time)
    wrong = np.flatnonzero(steps < 0.0 if may_repeat else steps <= 0.0)
    if wrong.size:
        row = int(wrong[0]) + 1
        raise RecordingError(f"{path}: line {lines[row]}: time {time[row]:.9g} follows {time[row - 1]:.9g}; it must increase by row")
