"""Settings of a drive that somebody changes while it runs: the run stops at once, and what comes after that needs them works."""

from __future__ import annotations

import pytest
from bench_machines import CARM

from hil.faults.check import run_trial
from hil.faults.motion import motion_of
from hil.faults.trials import KILLED, KILLED_AFTER_S, trials

SWEEP = "foreign_sdo/roll_drive/sweep"
WRITTEN = ("index=1016h/subindex=1", "index=6007h", "index=605Ah", "index=6085h/value=100", "index=6060h/value=9")
BY_DAY = ("index=1016h/subindex=1", "index=605Ah")
"""Whether the drive notices that the bench is gone, and what it does then."""
NOTICED_MRAD = 2.0 * 1e3 * CARM.limits[1].speed / CARM.sample_rate_Hz
"""Two ticks at the speed limit."""
QUICK_STOP_MRAD, SWINGING_MRAD = 30.0, 90.0
"""To the standstill of a quick stop from the sweep, with the brake; and without it, until the arm swings no more on its gear."""


def rows() -> list[str]:
    return [row.name for row in trials(CARM, "roll", ["foreign_sdo"])]


def test_each_write_is_tried_alone_without_a_brake_with_all_killed_and_both() -> None:
    expected = {
        "/".join(filter(None, (SWEEP, each, how))) for each in WRITTEN for how in ("", "without_brake", "killed", "without_brake/killed")
    }
    assert set(rows()) == {f"{SWEEP}/reads=1", *expected}


def test_killed_means_that_neither_bus_nor_io_is_reached_any_more() -> None:
    (row,) = trials(CARM, "roll", [f"{SWEEP}/index=605Ah/killed"])
    assert row.killed
    fault, *dead = row.settings
    assert [(each.name, each.at) for each in dead] == list(KILLED)
    assert {each.from_s for each in dead} == {KILLED_AFTER_S}
    assert {each.when for each in dead} == {fault.when}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(f"{SWEEP}/{each}/without_brake/killed", marks=() if each in BY_DAY else pytest.mark.nightly, id=each)
        for each in WRITTEN
    ],
)
def test_what_was_changed_is_there_again_when_all_processes_are_dead_and_the_brake_stays_open(name: str) -> None:
    (row,) = trials(CARM, "roll", [name])
    outcome = run_trial(CARM, "roll", row, motion_of(CARM, "roll"))
    assert (outcome.verdict, outcome.ending, outcome.contradicted) == ("stopped", "held by its drive", ())
    assert "somebody else sends 602h, SDO requests to roll_drive, and writes" in outcome.said
    assert 1e3 * outcome.travel < SWINGING_MRAD
    assert outcome.budget is not None
    assert (outcome.budget.name, outcome.budget.kept) == ("bench_silent", True)


@pytest.mark.parametrize("name", [f"{SWEEP}/reads=1", f"{SWEEP}/index=605Ah"])
def test_a_foreign_request_stops_the_run_in_two_ticks(name: str) -> None:
    (row,) = trials(CARM, "roll", [name])
    outcome = run_trial(CARM, "roll", row, motion_of(CARM, "roll"))
    assert (outcome.verdict, outcome.ending, outcome.contradicted) == ("stopped", "held by its brake", ())
    assert 1e3 * outcome.travel < QUICK_STOP_MRAD + NOTICED_MRAD
    assert "at rest: brake proven, voltage off" in outcome.said


@pytest.mark.slow
@pytest.mark.parametrize("row", trials(CARM, "roll", ["setting_changes"]), ids=lambda row: row.name)
def test_a_setting_that_changes_without_a_frame_is_found_and_put_right_while_the_machine_runs(row: object) -> None:
    outcome = run_trial(CARM, "roll", row, motion_of(CARM, "roll"))  # type: ignore[arg-type]
    assert (outcome.verdict, outcome.contradicted) == ("stopped", ())
    assert "was written: somebody, or the device itself, has changed it" in outcome.said
