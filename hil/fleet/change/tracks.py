"""Tracks of results: what every machine's parameters were, night by night, with their covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.errors import UnusableInputError
from hil.extras import extra_package

COLUMNS = (
    "machine", "night", "task", "experiment", "quantity", "value", "standard_deviation", "unit", "covariance_group", "covariance",
    "covariance_index", "software_version", "machine_file_hash",
)  # fmt: skip


class Parameter(NamedTuple):
    """A quantity that a task takes from an experiment, with its unit."""

    task: str
    experiment: str
    quantity: str
    unit: str

    @property
    def key(self) -> str:
        """Task, experiment and quantity in one word."""
        return "/".join((self.task, self.experiment, self.quantity))


@dataclass(frozen=True, eq=False)
class Tracks:
    """Results of a fleet.

    Parameters
    ----------
    machines : sequence of str, M of them
    nights : (T,) array of datetime64[D], rising
    parameters : sequence of Parameter, P of them
    values : (M, T, P) array
        In each parameter's unit; NaN where there is no result.
    covariances : (M, T, P, P) array
        As the tasks measured them; 0 where nothing is known.
    builds : (M, T, 2) array of int
        Numbers that stand for software version and machine file, in this order; -1 where there is no result.
    """

    machines: Sequence[str]
    nights: np.ndarray
    parameters: Sequence[Parameter]
    values: np.ndarray
    covariances: np.ndarray
    builds: np.ndarray

    def until(self, nights: int) -> Tracks:
        """Return the first nights alone."""
        values, covariances, builds = self.values[:, :nights], self.covariances[:, :nights], self.builds[:, :nights]
        return Tracks(self.machines, self.nights[:nights], self.parameters, values, covariances, builds)


def read_tracks(store: Path) -> Tracks:
    """Read the results of a store: `STORE/results/machine=NAME/date=YYYY-MM-DD/*.parquet`, one row a quantity.

    Of several results of one quantity on one night the latest counts.

    Raises
    ------
    UnusableInputError
        There are no results, or they lack a column.
    """
    duckdb = extra_package("duckdb", "the results of a fleet")
    if not any((store / "results").glob("*/*/*.parquet")):
        raise UnusableInputError(f"{store}: no results in {store / 'results'}; isocenter fleet run makes them")
    files = str(store / "results" / "*" / "*" / "*.parquet").replace("'", "''")
    try:
        table = duckdb.sql(
            f"SELECT {', '.join(COLUMNS)} FROM read_parquet('{files}', hive_partitioning = false, union_by_name = true)"
            " WHERE value IS NOT NULL AND isfinite(value) ORDER BY night, machine, covariance_group, covariance_index"
        ).fetchnumpy()
    except duckdb.Error as error:
        raise UnusableInputError(f"{store}: results that cannot be read: {str(error).splitlines()[0]}") from None
    if not len(table["value"]):
        raise UnusableInputError(f"{store}: no numbers in its results; a fleet of checks alone has nothing that could change")
    return _tracks({name: _plain(column) for name, column in table.items()})


def _plain(column: np.ndarray) -> np.ndarray:
    """Return a column without a mask: NaN or "" where it was NULL."""
    if not np.ma.isMaskedArray(column):
        return column
    empty: float | str = np.nan if column.dtype.kind == "f" else -1 if column.dtype.kind == "i" else ""
    return np.asarray(column.filled(empty))


def _tracks(table: dict[str, np.ndarray]) -> Tracks:
    machines, machine = np.unique(table["machine"].astype(str), return_inverse=True)
    nights, night = np.unique(table["night"].astype("datetime64[D]"), return_inverse=True)
    texts = [table[name].astype(str) for name in ("task", "experiment", "quantity", "unit")]
    named = [Parameter(*map(str, row)) for row in zip(*texts, strict=True)]
    parameters = sorted(set(named))
    number = {parameter: place for place, parameter in enumerate(parameters)}
    place = np.array([number[parameter] for parameter in named])
    shape = (len(machines), len(nights), len(parameters))
    values, covariances = np.full(shape, np.nan), np.zeros((*shape, shape[2]))
    values[machine, night, place] = table["value"]
    deviations = table["standard_deviation"]
    variances = np.where(np.isfinite(deviations), deviations, 0.0) ** 2
    covariances[machine, night, place, place] = variances
    groups: dict[tuple[int, int, str], list[int]] = {}
    for row, group in enumerate(table["covariance_group"].astype(str)):
        if group:
            groups.setdefault((machine[row], night[row], group), []).append(row)
    for (m, t, _), rows in groups.items():
        indices = table["covariance_index"][rows].astype(int)
        for row in rows:
            line = table["covariance"][row]
            if line is not None and np.size(line) > indices.max():
                covariances[m, t, place[row], place[rows]] = np.asarray(line, dtype=float)[indices]
    builds = np.full((*shape[:2], 2), -1)
    for which, name in enumerate(("software_version", "machine_file_hash")):
        builds[machine, night, which] = np.unique(table[name].astype(str), return_inverse=True)[1]
    return Tracks([str(each) for each in machines], nights, parameters, values, covariances, builds)
