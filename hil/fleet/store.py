"""Results of a fleet as Parquet, a file per task in folders by machine and date, and questions about them in SQL."""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.errors import RecordingError, UnusableInputError
from hil.extras import extra_package
from hil.files.atomic import write_atomically

RESULTS = "results"
"""Folder of the results in a store."""

COLUMNS = {
    "machine": "string",
    "night": "timestamp",
    "task": "string",
    "experiment": "string",
    "quantity": "string",
    "value": "double",
    "standard_deviation": "double",
    "unit": "string",
    "covariance_group": "string",
    "covariance": "doubles",
    "covariance_index": "integer",
    "verdict": "string",
    "message": "string",
    "software_version": "string",
    "machine_file_hash": "string",
    "recording_hashes": "strings",
}
"""Columns of a result's rows. `covariance` is this quantity's row of the covariance of its group, in the order of `covariance_index`."""

NO_ROWS = "create view results as select * from (values {0}) as none({1}) where false"
_SQL_TYPES = {
    "string": "varchar",
    "timestamp": "timestamp",
    "double": "double",
    "doubles": "double[]",
    "integer": "bigint",
    "strings": "varchar[]",
}


@dataclass(frozen=True)
class Table:
    """The answer to a question: names of columns, and rows."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def documents(self) -> list[dict[str, Any]]:
        """Return a mapping per row, for JSON: times as ISO 8601 text, numbers that are none as None."""
        return [{name: _plain(value) for name, value in zip(self.columns, row, strict=True)} for row in self.rows]


def write_results(store: Path, results: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    """Write the rows of tasks under their names, each whole or not at all; they are flushed to the disk together.

    Raises
    ------
    RecordingError
        A file cannot be written: disk full, no permission. Those before it are.
    """
    files = {store / RESULTS / name: _parquet(rows) for name, rows in results.items()}
    for folder in dict.fromkeys(path.parent for path in files):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise UnusableInputError(f"{folder}: cannot be made: {problem.strerror}; give another --store") from None
    try:
        write_atomically(files)
    except RecordingError:
        for path, content in files.items():  # what fits is kept
            write_atomically({path: content})


def _parquet(rows: Sequence[Mapping[str, Any]]) -> bytes:
    arrow = extra_package("pyarrow", "results of a fleet")
    parquet = extra_package("pyarrow.parquet", "results of a fleet")
    file = io.BytesIO()
    columns = {name: [row[name] for row in rows] for name in COLUMNS}
    parquet.write_table(arrow.Table.from_pydict(columns, schema=_schema()), file, compression="zstd")
    return file.getvalue()


@functools.cache
def _schema() -> Any:  # noqa: ANN401, no types
    arrow = extra_package("pyarrow", "results of a fleet")
    types = {
        "string": arrow.string(),
        "timestamp": arrow.timestamp("us", tz="UTC"),
        "double": arrow.float64(),
        "doubles": arrow.list_(arrow.float64()),
        "integer": arrow.int64(),
        "strings": arrow.list_(arrow.string()),
    }
    return arrow.schema([(name, types[kind]) for name, kind in COLUMNS.items()])


def names_in(store: Path) -> set[str]:
    """Return the names of all results."""
    folder = store / RESULTS
    return {path.relative_to(folder).as_posix() for path in folder.glob("machine=*/date=*/*.parquet")}


def query_fleet(store: str | Path, sql: str) -> Table:
    """Ask a question about the results of a fleet, in the SQL of DuckDB.

    The table is `results`, with the columns of `COLUMNS`, times in UTC, and `file`. The question can read the store and nothing else.

    Raises
    ------
    UnusableInputError
        There is no such store, or the SQL is wrong.
    """
    with results(Path(store)) as database:
        duckdb = extra_package("duckdb", "questions about results")
        try:
            asked = database.execute(sql)
            return Table(tuple(column[0] for column in asked.description or ()), tuple(asked.fetchall()))
        except duckdb.Error as problem:
            raise UnusableInputError(f"query: {' '.join(str(problem).split())}") from None


@contextmanager
def results(store: Path) -> Iterator[Any]:
    """Open a database in memory whose view `results` is the rows of a store, and which can read nothing else.

    Raises
    ------
    UnusableInputError
        There is no such store.
    """
    duckdb = extra_package("duckdb", "questions about results")
    folder = (store / RESULTS).absolute()
    if not store.is_dir():
        raise UnusableInputError(f"{store}: there is no such store; `isocenter fleet run` makes it")
    with duckdb.connect(config={"autoinstall_known_extensions": "false", "autoload_known_extensions": "false"}) as database:
        database.execute(_view(folder))
        database.execute(f"set allowed_directories = [{_quoted(folder)}]")
        database.execute("set enable_external_access = false")
        database.execute("set lock_configuration = true")
        yield database


def _view(folder: Path) -> str:
    """Return the statement that makes the view; its names are those that are there now."""
    if next(folder.glob("machine=*/date=*/*.parquet"), None) is None:
        kinds = [*COLUMNS.items(), ("file", "string")]
        return NO_ROWS.format(
            "(" + ", ".join(f"cast(null as {_SQL_TYPES[kind]})" for _, kind in kinds) + ")", ", ".join(name for name, _ in kinds)
        )
    pattern = _quoted(folder / "machine=*" / "date=*" / "*.parquet")
    names = ", ".join("make_timestamp(epoch_us(night)) as night" if name == "night" else name for name in COLUMNS)  # in UTC
    of_file = f"filename[{len(str(folder)) + 2}:] as file"
    return f"create view results as select {names}, {of_file} from read_parquet({pattern}, hive_partitioning = false, filename = true)"


def _quoted(path: Path) -> str:
    return "'" + str(path).replace("'", "''") + "'"


def remove_results(store: Path, names: Iterable[str]) -> None:
    """Remove results that newer ones have replaced; another run may have done so already."""
    for name in names:
        (store / RESULTS / name).unlink(missing_ok=True)


def _plain(value: object) -> object:
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return value if isinstance(value, str | int | float | bool | None) else str(value)
