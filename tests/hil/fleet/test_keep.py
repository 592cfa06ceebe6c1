"""Results are written beside the computing, all of them by the end, and a disk that takes no more is told of."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

import hil
from hil.errors import UnusableInputError
from hil.fleet.keep import Keeper
from hil.fleet.store import COLUMNS, names_in, write_results

pytest.importorskip("duckdb")


def row(machine: str, value: float) -> dict[str, Any]:
    """A row of a result."""
    texts = dict.fromkeys(COLUMNS, "")
    none: list[float] = []
    numbers = {"value": value, "standard_deviation": 0.1, "covariance": none, "covariance_index": 0, "recording_hashes": none}
    return {**texts, **numbers, "machine": machine, "night": datetime(2026, 11, 27, tzinfo=UTC)}


def name(machine: int) -> str:
    return f"machine=m{machine}/date=2026-11-27/check-0.parquet"


def test_all_is_there_when_the_block_ends_and_what_was_replaced_is_not(tmp_path: Path) -> None:
    with Keeper(tmp_path) as keeper:
        for machine in range(40):
            keeper.keep(name(machine), [row(f"m{machine}", machine / 3.0)])
    with Keeper(tmp_path) as keeper:
        keeper.keep("machine=m0/date=2026-11-27/check-1.parquet", [row("m0", 7.0)], [name(0)])
    assert names_in(tmp_path) == {name(machine) for machine in range(1, 40)} | {"machine=m0/date=2026-11-27/check-1.parquet"}
    values = dict(hil.query_fleet(tmp_path, "select machine, value from results").rows)
    assert values == {f"m{machine}": machine / 3.0 for machine in range(1, 40)} | {"m0": 7.0}
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_store_that_takes_no_more_is_told_of_and_what_was_written_is_kept(tmp_path: Path) -> None:
    with Keeper(tmp_path) as keeper:
        keeper.keep(name(1), [row("m1", 1.0)])
    (tmp_path / "results/machine=m2").write_text("where a folder should be")
    with pytest.raises(UnusableInputError, match="machine=m2"), Keeper(tmp_path) as keeper:
        keeper.keep(name(2), [row("m2", 2.0)])
    assert names_in(tmp_path) == {name(1)}


def test_of_results_that_do_not_all_fit_those_that_fit_are_kept(tmp_path: Path) -> None:
    taken = tmp_path / "results" / name(2)
    (taken / "a folder in its place").mkdir(parents=True)
    with pytest.raises(hil.RecordingError, match="machine=m2"):
        write_results(tmp_path, {name(machine): [row(f"m{machine}", 1.0)] for machine in (1, 2)})
    assert name(1) in {path.relative_to(tmp_path / "results").as_posix() for path in tmp_path.rglob("*.parquet") if path.is_file()}
