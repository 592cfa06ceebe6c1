"""Parquet recordings (`.parquet`): a column per channel, missing samples null, units in the columns' metadata, read and written by pyarrow.

The table's metadata hold the recording's as TOML text under `isocenter`. A file of another tool is read with a machine: a column's unit
is that of its metadata (`unit`) or of a name `name [unit]`, and else the machine's.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import RecordingError
from hil.extras import extra_package
from hil.files.atomic import write_atomically
from hil.files.regular import MOST_BYTES
from hil.recording.channels import is_whole
from hil.recording.metadata import machine_table, metadata_text, parse_metadata
from hil.recording.naming import Column, Columns, Target, header_name, named_channels, own_target
from hil.recording.rasters import channels_in_order
from hil.recording.recording import Recording
from hil.recording.said import source_table

if TYPE_CHECKING:
    from hil.machine.machine import Machine

_KEY, _UNIT = b"isocenter", b"unit"


def write_parquet(recording: Recording, path: Path) -> None:
    """Write a recording; numbers read back bit for bit.

    Raises
    ------
    RecordingError
        The file cannot be written.
    UnusableInputError
        pyarrow is not installed.
    """
    arrow, parquet = _packages()
    arrays, fields = [], []
    for name, channel in recording.channels.items():
        values, missing = channel.values, channel.missing
        whole = is_whole(name) and bool(np.all(values[~missing] == np.rint(values[~missing])))
        numbers = np.where(missing, 0.0, values).astype(np.int64) if whole else values
        arrays.append(arrow.array(numbers, mask=missing))
        fields.append(arrow.field(name, arrays[-1].type, metadata={_UNIT: channel.unit.encode()}))
    schema = arrow.schema(fields, metadata={_KEY: metadata_text(recording.metadata).encode()})
    content = io.BytesIO()
    parquet.write_table(arrow.table(arrays, schema=schema), content)
    write_atomically({path: content.getvalue()})


def read_parquet(path: Path, machine: Machine | None = None, names: Mapping[str, Target] | None = None, part: str = "") -> Recording:
    """Read a recording of this project, or any Parquet table.

    Parameters
    ----------
    path : Path
    machine : Machine, optional
        For a file that carries none.
    names : mapping, optional
        Name in the file -> channel. Without it, columns with a channel's name are taken.
    part : str
        Of rows of several senders those to take, as in `stamps`.

    Raises
    ------
    RecordingError
        The file is damaged, is too large, or names neither machine nor channels.
    UnusableInputError
        pyarrow is not installed.
    """
    arrow, parquet = _packages()
    try:
        with parquet.ParquetFile(path) as file:
            rows, width = file.metadata.num_rows, file.metadata.num_columns
            if rows * width * 8 > MOST_BYTES:
                most = MOST_BYTES // 8
                raise RecordingError(f"{path}: claims {rows} rows of {width} columns; at most {most} numbers are read into memory")
            table = file.read()
    except RecordingError:
        raise
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read, or damaged: {_line(problem)}") from None
    except (arrow.ArrowException, ValueError, UnicodeDecodeError, MemoryError) as problem:
        raise RecordingError(f"{path}: no Parquet file, or damaged: {_line(problem)}") from None
    try:
        return (
            _own(table, path, machine, names)
            if _KEY in (table.schema.metadata or {})
            else _foreign(arrow, table, path, machine, names, part)
        )
    except (arrow.ArrowException, UnicodeDecodeError) as problem:
        raise RecordingError(f"{path}: damaged: {_line(problem)}") from None


def _own(table: Any, path: Path, machine: Machine | None, names: Mapping[str, Target] | None) -> Recording:  # noqa: ANN401, no types
    metadata = parse_metadata(table.schema.metadata[_KEY].decode(), f"{path}: metadata")
    columns = {field.name: _column(table[k], _unit(field) or "") for k, field in enumerate(table.schema)}
    wanted = {name: Target(name) for name in columns if name not in (names or {})} | dict(names or {})
    channels, _ = named_channels(Columns(columns), wanted, machine, path)
    try:
        return Recording({one.channel: channels[one.channel] for one in wanted.values()}, metadata)
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _foreign(
    arrow: ModuleType,
    table: Any,  # noqa: ANN401
    path: Path,
    machine: Machine | None,
    names: Mapping[str, Target] | None,
    part: str,
) -> Recording:
    if machine is None:
        raise RecordingError(f"{path}: carries no machine, so it is no recording of ours; name the machine with --machine")
    columns: dict[str, Column] = {}
    others: dict[str, str] = {}
    twice = {name for name in table.schema.names if table.schema.names.count(name) > 1}
    for place, field in enumerate(table.schema):
        name, unit = header_name(field.name)
        name = field.name if field.name in (names or {}) else name
        if field.name in twice or name in columns:
            others[name] = "twice in the table"
        elif arrow.types.is_temporal(field.type) and not arrow.types.is_date(field.type):
            columns[name] = _times(arrow, table[place])
        elif any(fits(field.type) for fits in _numbers(arrow)):
            columns[name] = _column(table[place], _unit(field) or unit)
        else:
            others[name] = f"of type {field.type}"
    found = Columns(columns, {}, others)
    wanted = dict(names) if names else {name: Target(own.channel) for name in columns if (own := own_target(name, machine)) is not None}
    if not any(one.channel == "time" for one in wanted.values()):
        has = ", ".join([*columns, *others])
        raise RecordingError(f"{path}: no column is time; it has {has}; say which is which, such as --map t=time")
    channels, _ = named_channels(found, wanted, machine, path)
    channels, order = channels_in_order(channels, path, part)
    not_taken = [name for name in columns if name not in wanted] + [f"{name}, {what}" for name, what in others.items()]
    renamed = {name: one.channel for name, one in wanted.items() if name != one.channel}
    try:
        return Recording(channels, {"machine": machine_table(machine), "source": source_table(path, not_taken, order, renamed)})
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _numbers(arrow: ModuleType) -> tuple[Callable[[Any], bool], ...]:
    return arrow.types.is_integer, arrow.types.is_floating, arrow.types.is_boolean, arrow.types.is_decimal


def _column(values: Any, unit: str | None) -> Column:  # noqa: ANN401
    numbers = np.asarray(values.cast("float64", safe=False).to_numpy(), dtype=np.float64)
    return Column(numbers, unit)


def _times(arrow: ModuleType, values: Any) -> Column:  # noqa: ANN401
    """Return times of day and durations as seconds since the first."""
    unit = values.type.unit
    counts = values.cast(arrow.int32() if values.type.bit_width == 32 else arrow.int64())
    numbers = np.asarray(counts.cast("int64").fill_null(0).to_numpy(), dtype=np.int64)
    start = numbers[0] if numbers.size else 0
    seconds = (numbers - start) * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    return Column(np.where(np.asarray(values.is_null().to_numpy(), dtype=bool), np.nan, seconds), "s")


def _unit(field: Any) -> str | None:  # noqa: ANN401
    unit = (field.metadata or {}).get(_UNIT)
    return None if unit is None else str(unit.decode())


def _packages() -> tuple[ModuleType, ModuleType]:
    return extra_package("pyarrow", "Parquet files"), extra_package("pyarrow.parquet", "Parquet files")


def _line(problem: BaseException) -> str:
    return str(problem).strip().partition("\n")[0] or type(problem).__name__
