"""CSV recordings: a header of `name [unit]` cells, a row per SYNC, empty cells for missing samples, metadata in a `.toml` beside it.

Files of other tools may separate their cells by semicolons or tabs, and then have decimal commas.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.files.atomic import write_atomically
from hil.files.regular import check_regular
from hil.recording.channels import check_name, is_whole, unit_and_factor
from hil.recording.metadata import machine_table, metadata_text, parse_metadata
from hil.recording.model import CAN_FRAMES, Channel, Recording
from hil.recording.naming import Column, Columns, Target, header_name, is_header_cell, machine_unit, picked
from hil.recording.said import source_table

if TYPE_CHECKING:
    from _csv import Reader

    from hil.machine.model import Machine


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


def read_csv(path: Path, machine: Machine | None = None, names: Mapping[str, Target] | None = None) -> Recording:
    """Read a CSV recording.

    Parameters
    ----------
    path : Path
    machine : Machine, optional
        Replaces the metadata where there is no `.toml` of the same name.
    names : mapping, optional
        Name in the header -> channel. Columns that it does not name keep theirs.

    Raises
    ------
    RecordingError
        A ragged row, a cell that is no number, a hole in time, time that does not increase, a unit that the channel cannot have, a channel
        twice, fewer rows than the metadata say, or neither metadata nor machine; the message names the line.
    """
    text = _read_text(path)
    metadata = _metadata_of(path, machine)
    rows = metadata.pop("rows", None)
    if rows is not None and not text.endswith("\n"):
        raise RecordingError(f"{path}: line {text.count(chr(10)) + 1}: the last line is not complete; the file was cut off")
    table = _parse(path, text, names or {}, machine)
    values, lines = table.values, table.lines
    if rows is not None and rows != len(values):
        beside = metadata_path(path).name
        raise RecordingError(f"{path}: {len(values)} rows, but {beside} says rows = {rows}; the file was cut off or edited")
    channels = {one.channel: Channel(one.unit or "", values[:, column]) for column, one in enumerate(table.targets)}
    _check_time(path, channels["time"].values, lines, may_repeat=metadata.get("kind") == CAN_FRAMES)
    if names or table.not_taken:
        renamed = {name: one.channel for name, one in (names or {}).items()}
        metadata["source"] = source_table(path, table.not_taken, (), renamed)
    try:
        return Recording(channels, metadata)
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _cells(name: str, values: np.ndarray) -> list[str]:
    if is_whole(name):
        return ["" if value != value else str(int(value)) if value.is_integer() else repr(value) for value in values.tolist()]
    return ["" if value != value else repr(value) for value in values.tolist()]


def _read_text(path: Path) -> str:
    check_regular(path, RecordingError)
    try:
        return path.read_bytes().decode("utf-8-sig")
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
        return parse_metadata(_read_text(beside), str(beside))
    except RecordingError as problem:
        raise RecordingError(f"{problem}; {reason}" if reason else str(problem)) from None


@dataclass(frozen=True)
class _Table:
    """What a file holds."""

    targets: Sequence[Target]  # of every column that is taken
    values: np.ndarray  # (rows, columns taken)
    lines: list[int]  # of the file, of each row
    not_taken: Sequence[str]


def _parse(path: Path, text: str, names: Mapping[str, Target], machine: Machine | None) -> _Table:
    delimiter, text, skipped = _delimiter(text)
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=delimiter)
    records = _records(path, reader)
    header = next(records, None)
    if header is None:
        raise RecordingError(f"{path}: line 1: empty; a header of `name [unit]` cells is first")
    if len(header) > 1 and delimiter != "," and not header[-1].strip():  # a delimiter behind each row, as spreadsheets write it
        header.pop()
    targets, not_taken = _targets(path, header, names, machine)
    named = {one.channel for one in names.values()}
    places = [place for place, one in enumerate(targets) if one is not None]
    rows: list[list[float]] = []
    lines: list[int] = []
    decimals: set[str] = set()
    no_numbers: dict[int, str] = {}  # place of a column that may be left out -> its first cell that is no number
    for cells in records:
        line = reader.line_num + skipped
        if not cells:
            continue
        if len(cells) == len(header) + 1 and delimiter != "," and not cells[-1].strip():
            cells.pop()
        if len(cells) != len(header):
            raise RecordingError(f"{path}: line {line}: {len(cells)} cells, the header has {len(header)}")
        row = []
        for place in places:
            cell = cells[place]
            try:
                row.append((float(cell) if cell else np.nan) if delimiter == "," else _local_number(cell, decimals))
            except ValueError:
                one = targets[place]
                if cell.strip() and (one is None or not named or one.channel in {"time", *named}):
                    raise RecordingError(f"{path}: line {line}: {header[place]} = {cell.strip()!r} is no number") from None
                row.append(np.nan)
                if cell.strip():
                    no_numbers.setdefault(place, f"{header[place]}: line {line}: {cell.strip()[:40]!r} is no number")
        if len(decimals) > 1:
            raise RecordingError(f"{path}: line {line}: decimal commas and points in one file; one of them would be right")
        rows.append(row)
        lines.append(line)
    if not rows:
        raise RecordingError(f"{path}: line 1: a header and no rows")
    kept = [one for place, one in enumerate(targets) if one is not None and place not in no_numbers]
    values = np.array(rows)[:, [place not in no_numbers for place in places]]
    values = values * [one.scale for one in kept] + [one.offset for one in kept]
    return _Table(kept, values, lines, [*not_taken, *no_numbers.values()])


def _local_number(cell: str, decimals: set[str]) -> float:
    """Return the number of a cell that may have a decimal comma, and add what marks its decimals; ValueError if it is none."""
    cell = cell.strip()
    if not cell:
        return np.nan
    marks = [mark for mark in cell if mark in ",."]
    if len(marks) > 1:
        raise ValueError(cell)
    value = float(cell.replace(",", "."))
    decimals.update(marks)
    return value


def _delimiter(text: str) -> tuple[str, str, int]:
    """Return what separates cells, the text without a spreadsheet's line `sep=;`, and the lines left out.

    No channel's name has a comma in it, so a header with semicolons or tabs is separated by them.
    """
    first, _, rest = text.partition("\n")
    if re.fullmatch(r"sep=[;,\t]", first.strip("\r")):
        return first.strip("\r")[-1], rest, 1
    return next((mark for mark in ";\t" if mark in re.sub(r'"[^"]*"', "", first)), ","), text, 0


def _records(path: Path, reader: Reader) -> Iterator[list[str]]:
    """Yield the reader's records; its errors become RecordingError."""
    try:
        yield from reader
    except csv.Error as problem:
        raise RecordingError(f"{path}: line {reader.line_num}: {problem}") from None


def _targets(path: Path, cells: list[str], names: Mapping[str, Target], machine: Machine | None) -> tuple[list[Target | None], list[str]]:
    """Return what each column becomes, and which columns are not taken."""
    foreign = [header_name(cell) for cell in cells]
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
        try:
            if one := names.get(cell.strip(), names.get(name)):
                unit = one.unit if one.unit is not None else unit
                unit = machine_unit(one.channel, machine, path) if unit is None and machine is not None else unit
                unit_and_factor(one.channel, unit or "")
                targets.append(one._replace(unit=unit or ""))
            else:
                targets.append(_own(cell, name, unit, taken, named=bool(names)))
                taken.add(name)
        except RecordingError as problem:
            if not names or cell.strip() in names or name in names:
                said = str(problem)
                raise RecordingError(said if said.startswith(str(path)) else f"{path}: line 1: {said}") from None
            targets.append(None)
            not_taken.append(f"{name or 'column without a name'}: {problem}")
    if "time" not in {one.channel for one in targets if one is not None}:
        raise RecordingError(f"{path}: line 1: no column `time [s]`")
    return targets, not_taken


def _own(cell: str, name: str, unit: str | None, taken: set[str], *, named: bool) -> Target:
    """Return the target of a column that keeps its name."""
    if not is_header_cell(cell):
        raise RecordingError(f"header cell {cell!r} is not `name [unit]`")
    unit_and_factor(check_name(name), unit or "")
    if name in taken:
        raise RecordingError(f"another column is to be {name}" if named else f"channel {name} stands there twice")
    return Target(name, unit or "")


def _check_time(path: Path, time: np.ndarray, lines: list[int], *, may_repeat: bool) -> None:
    holes = np.flatnonzero(~np.isfinite(time))
    if holes.size:
        raise RecordingError(f"{path}: line {lines[holes[0]]}: time is missing; every row has its time")
    steps = np.diff(time)
    wrong = np.flatnonzero(steps < 0.0 if may_repeat else steps <= 0.0)
    if wrong.size:
        row = int(wrong[0]) + 1
        raise RecordingError(f"{path}: line {lines[row]}: time {time[row]:.9g} follows {time[row - 1]:.9g}; it must increase by row")
