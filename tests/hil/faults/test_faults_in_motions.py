"""The table of faults while an arm is moved to a pose or homed: its rows, and what becomes of some of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM, carm_text_in, edited, homing_at_switch_text

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.errors import UnusableInputError
from hil.faults.check import TrialOutcome, check_faults
from hil.faults.motion import MotionName, motion_of
from hil.faults.page import document_of, is_failure, page_of
from hil.faults.trials import trials
from hil.machine import Machine, machine_from_text
from hil.pages import html_of

BY_ITSELF = machine_from_text(carm_text_in("profile_position"))
AT_SWITCH = machine_from_text(homing_at_switch_text())
HOT = "thermometer_high/roll/sweep", "temperature_roll: 150.0 degC, 120.0 are allowed"
CLOSED = "brake_feedback_stuck_closed/roll/sweep", "roll: its brake reports closed during the motion"


def tried(machine: Machine, motion: MotionName, folder: Path, *names: str) -> list[TrialOutcome]:
    rows = [row for name in names for row in trials(machine, "roll", [name], motion)]
    return check_faults(machine, "roll", rows, folder, motion=motion)


@pytest.mark.parametrize(("machine", "motion"), [(BY_ITSELF, "move"), (AT_SWITCH, "homing")])
def test_a_motion_without_a_standstill_before_it_has_no_fault_that_comes_in_one(machine: Machine, motion: MotionName) -> None:
    rows = trials(machine, "roll", motion=motion)
    assert len(rows) > 150
    assert {"sweep", "stop"} < {row.during for row in rows}
    assert "settled" not in {row.during for row in rows}


def test_a_homing_run_that_moves_nothing_is_refused() -> None:
    with pytest.raises(UnusableInputError, match="roll homes by method 37, which moves nothing; 17, 18, 33 and 34 do"):
        motion_of(CARM, "roll", "homing")


@pytest.mark.parametrize(
    ("method", "direction"), [(17, 1), (18, -1), *(pytest.param(*each, marks=pytest.mark.nightly) for each in ((17, -1), (18, 1)))]
)
def test_a_homing_run_begins_before_the_switch_that_its_drive_searches(method: int, direction: int, tmp_path: Path) -> None:
    text = edited(r"^\[drives.roll\]$", rf"\g<0>\ndirection = {direction}", homing_at_switch_text())
    if method == 18:
        text = edited(r"(\[bus.homing.roll\]\nmethod = )17", r"\g<1>18", text)
        text = edited(r"(index = 0x607C\nvalue = )-", r"\g<1>", text)
    machine = machine_from_text(text)
    motion = motion_of(machine, "roll", "homing")
    with open_bench(machine, BenchOptions("lockstep:"), motion.start_pose) as bench:
        motion.make(bench, tmp_path / "nothing.mf4")
    switch_deg = 95.0 * direction * (-1 if method == 17 else 1)
    assert np.degrees(bench.pose[1]) == pytest.approx(switch_deg, abs=2.0)
    assert np.degrees(motion.start_pose[1]) == pytest.approx(switch_deg - np.copysign(10.0, switch_deg))


@pytest.mark.parametrize(("machine", "motion", "fastest"), [(BY_ITSELF, "move", np.radians(60.0)), (AT_SWITCH, "homing", np.radians(5.0))])
def test_faults_come_near_the_motions_greatest_speed_and_are_stopped(
    machine: Machine, motion: MotionName, fastest: float, tmp_path: Path
) -> None:
    assert motion_of(machine, "roll", motion).speed == pytest.approx(fastest)
    names = ("hold_to_run_released/io/sweep", "node_unplugged/roll_drive/sweep", "torque_lost/roll_drive/sweep")
    outcomes = tried(machine, motion, tmp_path, *names)
    for outcome in outcomes:
        assert outcome.verdict == "stopped"
        assert not is_failure(outcome)
        roll = next(each for each in outcome.axes if each.axis == "roll")
        assert roll.fastest > 0.85 * fastest
    page = html_of(page_of(machine, "roll", outcomes, motion_of(machine, "roll", motion)))
    assert {"move": "a move of roll to a pose at up to 1.05 rad/s", "homing": "a homing run of roll at 0.087 rad/s"}[motion] in page
    assert document_of(machine, "roll", outcomes, motion_of(machine, "roll", motion))["motion"] == motion


@pytest.mark.parametrize("machine", [pytest.param(CARM, marks=pytest.mark.nightly), BY_ITSELF])
def test_what_is_found_of_the_sensors_on_a_way_is_told(machine: Machine, tmp_path: Path) -> None:
    silent, sound = tried(machine, "move", tmp_path, "imu_silent/imu/sweep", "frames_remote/roll_encoder/sweep")
    assert (silent.verdict, silent.exit_status) == ("noted", 1)
    assert "imu" in silent.said
    assert "late heartbeats" not in silent.said, "the nodes are sound"
    assert sound.exit_status == 0


@pytest.mark.parametrize(
    ("machine", "motion", "name", "words"),
    [
        (BY_ITSELF, "move", *HOT),
        (AT_SWITCH, "homing", *CLOSED),
        pytest.param(AT_SWITCH, "homing", *HOT, marks=pytest.mark.nightly),
        pytest.param(BY_ITSELF, "move", *CLOSED, marks=pytest.mark.nightly),
    ],
)
def test_what_stops_a_run_stops_a_motion_that_nobody_records(
    machine: Machine, motion: MotionName, name: str, words: str, tmp_path: Path
) -> None:
    (outcome,) = tried(machine, motion, tmp_path, name)
    assert outcome.verdict == "stopped"
    assert not is_failure(outcome)
    assert words in outcome.said


def test_a_drive_that_hears_no_sync_is_stopped_by_the_end_of_its_communication(tmp_path: Path) -> None:
    (deaf,) = tried(BY_ITSELF, "move", tmp_path, "node_deaf_to_sync/roll_drive/sweep")
    assert deaf.budget is not None
    assert deaf.budget.kept
    assert "its drive does not answer (its node is stopped)" in deaf.said


def test_a_reference_that_is_off_does_not_agree_with_the_link(tmp_path: Path) -> None:
    (shifted,) = tried(AT_SWITCH, "homing", tmp_path, "homing_shifted/roll_drive/start")
    assert shifted.verdict == "stopped"
    assert "they differ by" in shifted.said
