"""A fleet's new recordings become rows, once each, with the answer of the functions for one machine."""

from __future__ import annotations

import shutil
import threading
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.fleet.change import fleet_change, read_tracks
from hil.fleet.store import COLUMNS, names_in, write_results

pytest.importorskip("duckdb")

FLEET = """
format = 1
[every]
file = "turntable"
recordings = "recordings/{name}"
repeats = ["shake_*"]
tasks = ["check", "identify"]
[[machine]]
name = "one"
[[machine]]
name = "other"
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two repeats of a night of one machine, and of the other, which has a friction that its file lacks."""
    folder = tmp_path_factory.mktemp("fleet")
    turntable = hil.open_machine("turntable")
    shaken = hil.Multisine(period_s=1.0, periods=4, jog=None)
    rubbing = turntable.with_effect("coulomb_friction", turntable.axes[0], Fc_Nm=0.5)
    for name, really in (("one", turntable), ("other", rubbing)):
        (folder / "recordings" / name / "2026-11-27").mkdir(parents=True)
        for repeat in range(2):
            [found] = turntable.run(shaken, bus="lockstep:", seed=repeat, emulated=really)
            hil.write_recording(found, folder / f"recordings/{name}/2026-11-27/shake_{repeat}.csv")
    (folder / "fleet.toml").write_text(FLEET, encoding="utf-8")
    return folder


@pytest.fixture
def folder(recorded: Path, tmp_path: Path) -> Path:
    shutil.copytree(recorded, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture(scope="module")
def done(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of all results of these recordings."""
    run = hil.run_fleet(recorded / "fleet.toml", workers=0, store=tmp_path_factory.mktemp("store"))
    assert (run.planned, run.done, run.failures, run.wrong) == (6, 6, [], [])
    return run.store


def rows(store: Path, sql: str) -> tuple[tuple[object, ...], ...]:
    return hil.query_fleet(store, sql).rows


def test_the_rows_are_what_the_functions_for_one_machine_answer(recorded: Path, done: Path) -> None:
    turntable = hil.open_machine("turntable")
    recording = hil.read_recording(recorded / "recordings/other/2026-11-27/shake_0.csv")
    compared = hil.compare(recording, hil.simulate(turntable, recording))
    kept = rows(done, "select quantity, value, unit from results where machine = 'other' and task = 'check' and value is not null")
    for channel in compared.channels:
        assert (f"{channel.name} difference", channel.rms, channel.unit) in kept


def test_a_row_that_only_says_a_verdict_has_no_number(done: Path) -> None:
    assert rows(done, "select count(*), count(value) from results where quantity = 'verdict'") == ((4, 0),)
    assert rows(done, "select isfinite(max(value)) from results") == ((True,),)


def test_a_machine_that_is_not_as_its_file_says_differs(done: Path) -> None:
    verdicts = dict(
        rows(done, "select machine, list(distinct verdict) from results where task = 'check' and quantity = 'verdict' group by 1")
    )
    assert verdicts == {"one": ["agrees"], "other": ["differs"]}


def test_every_row_says_what_it_was_made_of(recorded: Path, done: Path) -> None:
    machine = hil.open_machine("turntable")
    asked = "select distinct machine_file_hash, strftime(night, '%Y-%m-%d'), len(recording_hashes) from results where task = 'identify'"
    assert rows(done, asked) == ((machine.hash, "2026-11-27", 4),)
    assert rows(done, "select count(*) from results where software_version not like 'isocenter%'") == ((0,),)


def test_friction_of_a_night_is_what_acted_with_the_covariance_of_what_was_fitted_together(folder: Path) -> None:
    (folder / "friction.toml").write_text(FLEET.replace('["check", "identify"]', '["friction"]'), encoding="utf-8")
    run = hil.run_fleet(folder / "friction.toml", workers=0)
    assert run.by_verdict == {"fitted": 2}
    asked = "select machine, quantity, value, standard_deviation, covariance, covariance_index from results where value is not null"
    found: dict[tuple[object, object], list[Any]] = {(machine, quantity): rest for machine, quantity, *rest in rows(run.store, asked)}
    for machine, really_Nm in (("one", 0.0), ("other", 0.5)):
        value, deviation, covariance, place = found[machine, "turn coulomb_friction Fc"]
        assert value == pytest.approx(really_Nm, abs=0.06)
        assert covariance[place] == pytest.approx(deviation**2)
        viscous = found[machine, "turn viscous_friction Fv"]
        assert covariance[viscous[3]] == pytest.approx(viscous[2][place])
        assert covariance[viscous[3]] != 0.0


def test_a_machine_that_changed_is_diagnosed_on_the_night_that_names_it(folder: Path) -> None:
    def row(machine: str, night: datetime, value: float) -> dict[str, object]:
        told = {"task": "friction", "experiment": "jog", "quantity": "turn friction", "value": value, "standard_deviation": 0.1}
        whose = {"machine": machine, "night": night, "software_version": "1", "machine_file_hash": "h"}
        return dict.fromkeys(COLUMNS) | told | whose | {"covariance_group": "", "covariance": [0.01], "covariance_index": 0}

    store, random = folder / "fleet-results", np.random.default_rng(3)
    nights = [datetime(2026, 11, 27) - timedelta(number) for number in range(30)]
    machines = ["one", "other", *(f"further_{number}" for number in range(8))]
    tracks = [(machine, night, random.normal(6.0, 0.1)) for machine in machines for night in sorted(nights)]
    stepped = [row(*each[:2], each[2] + (each[0] == "other" and each[1] > nights[9])) for each in tracks]
    write_results(store, {f"machine={each['machine']}/date={each['night']:%Y-%m-%d}/friction-0.parquet": [each] for each in stepped})
    [change] = fleet_change(read_tracks(store)).changes
    assert change.machine == "other"
    for machine in ("one", "other"):  # recordings of the night that names it, and of the one before
        recorded = folder / "recordings" / machine / "2026-11-27"
        shutil.copytree(recorded, recorded.parent / str(change.alarm - 1))
        recorded.rename(recorded.parent / str(change.alarm))
    text = FLEET.replace('["check", "identify"]', '["diagnose"]').replace("[[machine]]", 'diagnose_when = "changed"\n[[machine]]', 1)
    (folder / "fleet.toml").write_text(f"{text}[limits.diagnose]\ntime_s = 0.001\n", encoding="utf-8")  # which night counts, not its answer
    run = hil.run_fleet(folder / "fleet.toml", workers=0)
    assert (run.planned, run.unneeded, run.done) == (4, 3, 1)
    assert run.failures[0].startswith(f"other, {change.alarm}: diagnose")


def test_a_fleet_without_numbers_has_nothing_that_changed(folder: Path) -> None:
    text = FLEET.replace('["check", "identify"]', '["diagnose"]').replace("[[machine]]", 'diagnose_when = "changed"\n[[machine]]', 1)
    (folder / "fleet.toml").write_text(text, encoding="utf-8")
    run = hil.run_fleet(folder / "fleet.toml", workers=0)
    assert (run.planned, run.unneeded, run.done) == (2, 2, 0)


def test_a_rerun_does_nothing(folder: Path) -> None:
    first = hil.run_fleet(folder / "fleet.toml", workers=0)
    made = {name: (first.store / "results" / name).stat().st_mtime_ns for name in names_in(first.store)}
    again = hil.run_fleet(folder / "fleet.toml", workers=0)
    assert (again.done, again.present) == (0, 6)
    assert {name: (first.store / "results" / name).stat().st_mtime_ns for name in names_in(first.store)} == made


def test_a_recording_that_comes_later_replaces_the_night_s_answer_and_doubles_nothing(folder: Path) -> None:
    night = folder / "recordings/one/2026-11-27"
    for suffix in ("csv", "toml"):
        (night / f"shake_1.{suffix}").rename(folder / f"late.{suffix}")
    hil.run_fleet(folder / "fleet.toml", workers=0)
    for suffix in ("csv", "toml"):
        (folder / f"late.{suffix}").rename(night / f"shake_1.{suffix}")
    late = hil.run_fleet(folder / "fleet.toml", workers=0)
    assert late.done == 2  # its check, and the identification of both
    identified = rows(late.store, "select len(recording_hashes) from results where machine = 'one' and quantity = 'resonances'")
    assert identified == ((4,), (4,))  # a row per repeat


def test_a_corrupt_recording_is_named_and_costs_nothing_else(folder: Path) -> None:
    bad = folder / "recordings/one/2026-11-27/shake_0.csv"
    bad.write_text(bad.read_text(encoding="utf-8")[:5000], encoding="utf-8")
    (folder / "recordings/other/undated.csv").write_text("time [s]\n0.0\n", encoding="utf-8")
    run = hil.run_fleet(folder / "fleet.toml", workers=0)
    assert run.done == 6
    assert sorted(line.partition(": 2026")[0] for line in run.failures) == ["one, 2026-11-27: check", "one, 2026-11-27: identify"]
    assert all("2026-11-27/shake_0.csv: line" in line for line in run.failures)
    assert "undated.csv: its path has no date" in run.wrong[0]
    assert hil.run_fleet(folder / "fleet.toml", workers=0).done == 0


def test_a_task_that_hangs_is_named_and_computed_again_on_demand(folder: Path) -> None:
    short = (folder / "fleet.toml").read_text(encoding="utf-8") + "[limits.check]\ntime_s = 0.001\n"
    (folder / "short.toml").write_text(short, encoding="utf-8")
    run = hil.run_fleet(folder / "short.toml", workers=0)
    assert len(run.failures) == 4
    assert "check: gave no answer within 0.001 s" in run.failures[0]
    assert hil.run_fleet(folder / "fleet.toml", workers=0).done == 0
    again = hil.run_fleet(folder / "fleet.toml", workers=0, again="failed")
    assert (again.done, again.failures) == (4, [])


def test_two_runs_at_once_lose_and_double_nothing(folder: Path, done: Path) -> None:
    runs = [threading.Thread(target=hil.run_fleet, args=(folder / "fleet.toml",), kwargs={"workers": 0}) for _ in range(2)]
    for run in runs:
        run.start()
    for run in runs:
        run.join()
    counted = "select count(*), count(distinct file) from results"
    assert rows(folder / "fleet-results", counted) == rows(done, counted)


def test_a_question_reads_the_store_and_nothing_else(done: Path, tmp_path: Path) -> None:
    secret = tmp_path / "secret.csv"
    secret.write_text("a\n1\n", encoding="utf-8")
    for sql in (f"select * from read_csv('{secret}')", f"copy results to '{tmp_path / 'out.csv'}'", "select * from nothing"):
        with pytest.raises(hil.UnusableInputError, match="query: "):
            hil.query_fleet(done, sql)
    assert not (tmp_path / "out.csv").exists()


def test_status_counts_what_is_there_and_what_waits(folder: Path) -> None:
    hil.run_fleet(folder / "fleet.toml", workers=0)
    shutil.copytree(folder / "recordings/one/2026-11-27", folder / "recordings/one/2026-11-28")
    one, other = hil.fleet_status(folder / "fleet.toml").machines
    assert (one.nights, one.results, one.failed, one.waiting) == (1, 3, 0, 3)
    assert (other.differing, other.waiting) == (2, 0)
