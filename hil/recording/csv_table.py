"""CSV recordings: a header of `name [unit]` cells, a row per SYNC, empty cells for missing samples, metadata in a `.toml` beside it."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.files.atomic import write_atomically
from hil.files.regular import check_regular
from hil.recording.channels import check_name, is_whole, unit_and_factor
from hil.recording.metadata import MachineFile, machine_table, metadata_text, parse_metadata
from hil.recording.model import CAN_FRAMES, Channel, Recording

if TYPE_CHECKING:
    from _csv import Reader

_HEADER_CELL = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")


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


def read_csv(path: Path, machine: MachineFile | None = None) -> Recording:
    """Read a CSV recording.

    Parameters
    ----------
    path : Path
    machine : MachineFile, optional
        Replaces the metadata where there is no `.toml` of the same name.

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
    names, units, values, lines = _parse(path, text)
    if rows is not None and rows != len(values):
        beside = metadata_path(path).name
        raise RecordingError(f"{path}: {len(values)} rows, but {beside} says rows = {rows}; the file was cut off or edited")
    _check_time(path, values[:, names.index("time")], lines, may_repeat=metadata.get("kind") == CAN_FRAMES)
    channels = {name: Channel(unit, values[:, column]) for column, (name, unit) in enumerate(zip(names, units, strict=True))}
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


def _metadata_of(path: Path, machine: MachineFile | None) -> dict[str, Any]:
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


def _parse(path: Path, text: str) -> tuple[list[str], list[str], np.ndarray, list[int]]:
    """Return names, units, values (rows, columns) and the file's line of each row."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    records = _records(path, reader)
    header = next(records, None)
    if header is None:
        raise RecordingError(f"{path}: line 1: empty; a header of `name [unit]` cells is first")
    names, units = _parse_header(path, header)
    width = len(names)
    rows: list[list[float]] = []
    lines: list[int] = []
    for cells in records:
        if not cells:
            continue
        if len(cells) != width:
            raise RecordingError(f"{path}: line {reader.line_num}: {len(cells)} cells, the header has {width}")
        try:
            rows.append([float(cell) if cell else np.nan for cell in cells])
        except ValueError:
            rows.append([_number(path, reader.line_num, name, cell) for name, cell in zip(names, cells, strict=True)])
        lines.append(reader.line_num)
    if not rows:
        raise RecordingError(f"{path}: line 1: a header and no rows")
    return names, units, np.array(rows), lines


def _records(path: Path, reader: Reader) -> Iterator[list[str]]:
    """Yield the reader's records; its errors become RecordingError."""
    try:
        yield from reader
    except csv.Error as problem:
        raise RecordingError(f"{path}: line {reader.line_num}: {problem}") from None


def _parse_header(path: Path, cells: list[str]) -> tuple[list[str], list[str]]:
    if len(cells) == 1 and ";" in cells[0]:
        raise RecordingError(f"{path}: line 1: cells are separated by commas, not semicolons")
    names: list[str] = []
    units: list[str] = []
    for cell in cells:
        match = _HEADER_CELL.fullmatch(cell)
        if match is None or not match["name"]:
            raise RecordingError(f"{path}: line 1: header cell {cell!r} is not `name [unit]`")
        try:
            name, unit = check_name(match["name"]), (match["unit"] or "").strip()
            unit_and_factor(name, unit)
        except RecordingError as problem:
            raise RecordingError(f"{path}: line 1: {problem}") from None
        if name in names:
            raise RecordingError(f"{path}: line 1: channel {name} stands there twice")
        names.append(name)
        units.append(unit)
    if "time" not in names:
        raise RecordingError(f"{path}: line 1: no column `time [s]`")
    return names, units


def _number(path: Path, line: int, name: str, cell: str) -> float:
    cell = cell.strip()
    try:
        return float(cell) if cell else np.nan
    except ValueError:
        raise RecordingError(f"{path}: line {line}: {name} = {cell!r} is no number") from None


def _check_time(path: Path, time: np.ndarray, lines: list[int], *, may_repeat: bool) -> None:
    holes = np.flatnonzero(~np.isfinite(time))
    if holes.size:
        raise RecordingError(f"{path}: line {lines[holes[0]]}: time is missing; every row has its time")
    steps = np.diff(time)
    wrong = np.flatnonzero(steps < 0.0 if may_repeat else steps <= 0.0)
    if wrong.size:
        row = int(wrong[0]) + 1
        raise RecordingError(f"{path}: line {lines[row]}: time {time[row]:.9g} follows {time[row - 1]:.9g}; it must increase by row")
