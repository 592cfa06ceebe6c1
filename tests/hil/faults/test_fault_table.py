"""The table of faults: its rows, that it goes on where it was ended, and the page it makes."""

from __future__ import annotations

import json
import os
import signal
import threading
from pathlib import Path

import pytest
from bench_machines import CARM

from hil.errors import LoopAbortedError, UnusableInputError
from hil.faults.check import OUTCOMES, check_faults
from hil.faults.motion import motion_of
from hil.faults.page import document_of, page_of
from hil.faults.trials import swept_axis, trials
from hil.machine import load_machine
from hil.pages import html_of
from virtual_bus.faults.registry import fault_kinds

TABLE = trials(CARM, "roll")
FEW = ("hold_to_run_released/io/sweep", "brake_weak/roll/stop/share=0.05", "frames_remote/roll_drive/sweep", "sdo_silent/roll_drive/start")


def test_every_fault_of_the_emulated_machine_is_tried_but_those_that_it_cannot_show() -> None:
    emulated = {kind.name for kind in fault_kinds().values() if kind.begin is not None}
    assert {row.kind for row in TABLE} == emulated - {"limit_switch_stuck", "index_pulse_missing", "homing_wrong_direction", "sync_stops"}


def test_rows_have_names_of_their_own_and_are_many() -> None:
    names = [row.name for row in TABLE]
    assert len(set(names)) == len(names)
    assert len(names) >= 80


def test_a_machine_without_io_has_no_row_that_needs_one() -> None:
    turntable = load_machine("turntable")
    rows = trials(turntable, swept_axis(turntable))
    assert {row.at for row in rows} & {"io", "imu"} == set()
    assert not any(row.during == "stop" for row in rows)
    assert len(rows) >= 45


def test_a_fault_that_is_not_there_is_refused() -> None:
    with pytest.raises(UnusableInputError, match="--only brake_vanishes"):
        trials(CARM, "roll", ["brake_vanishes"])
    with pytest.raises(UnusableInputError, match="this machine cannot have it"):
        trials(CARM, "roll", ["index_pulse_missing"])
    with pytest.raises(UnusableInputError, match="--axis yaw"):
        swept_axis(CARM, "yaw")


def test_outcomes_are_kept_and_told(tmp_path: Path) -> None:
    rows = [row for name in FEW for row in trials(CARM, "roll", [name])]
    seen: list[str] = []
    check_faults(CARM, "roll", rows[:2], tmp_path, lambda done, outcome: seen.append(outcome.verdict))
    kept = (tmp_path / OUTCOMES).read_text()
    (tmp_path / OUTCOMES).write_text(kept + '{"key": "cut o')
    outcomes = check_faults(CARM, "roll", rows, tmp_path)
    assert (tmp_path / OUTCOMES).read_text().startswith(kept)
    assert len((tmp_path / OUTCOMES).read_text().splitlines()) == 2 + 1 + 2  # one of them was cut off
    released, weak, harmless, silent = outcomes
    assert seen == [released.verdict, weak.verdict]
    assert (released.verdict, released.ending, released.exit_status) == ("stopped", "held by its brake", 1)
    assert "hold-to-run was released" in released.said
    assert 0 < released.rows < released.planned
    assert 0.03 < released.travel < 0.15
    assert weak.travel > released.travel
    assert harmless.rows == harmless.planned
    assert silent.exit_status == 2
    assert silent.rows == 0
    page = html_of(page_of(CARM, "roll", outcomes, motion_of(CARM, "roll")))
    for outcome in outcomes:
        assert outcome.kind in page
    document = json.loads(json.dumps(document_of(CARM, "roll", outcomes, motion_of(CARM, "roll")), default=lambda value: vars(value)))
    assert document["verdicts"]["stopped"] >= 2


def test_a_user_who_asks_to_stop_ends_the_table_not_one_row(tmp_path: Path) -> None:
    rows = trials(CARM, "roll", ["homing_never_ends"])
    asking = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
    asking.start()
    with pytest.raises((LoopAbortedError, KeyboardInterrupt)):
        check_faults(CARM, "roll", rows, tmp_path)
    asking.join()
    kept = (tmp_path / OUTCOMES).read_text() if (tmp_path / OUTCOMES).exists() else ""
    assert "SIGINT" not in kept
