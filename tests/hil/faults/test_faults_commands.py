"""`isocenter faults`, and `--faults` of run and emulate, as their user sees them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bench_machines import edited
from command_line import Isocenter, runner

from virtual_bus.faults.registry import fault_kinds

SCAN = ("run", "scan", "-m", "carm", "--axis", "roll", "--from", "10", "--to", "-10", "--speed", "23", "--dwell", "0.1")
LOSES_POWER = "drive_loses_power/roll_drive/sweep"
RELEASED = '[[fault]]\nname = "hold_to_run_released"\nwhen = "abs(speed_roll) > 0.3"\n'


@pytest.fixture
def isocenter(capsys: pytest.CaptureFixture[str]) -> Isocenter:
    return runner(capsys)


def test_the_list_names_every_fault_its_class_and_its_place(isocenter: Isocenter, tmp_path: Path) -> None:
    outcome = isocenter("faults", "list", "--json", tmp_path / "list.json")
    assert outcome.status == 0
    assert [line.split()[0] for line in outcome.out.splitlines()] == list(fault_kinds())
    answer = json.loads((tmp_path / "list.json").read_text())
    assert [fault["name"] for fault in answer["faults"]] == list(fault_kinds())
    assert {fault["class"] for fault in answer["faults"]} >= {"drive", "brake", "I/O", "encoder", "IMU", "bus", "process", "homing"}
    assert "moving" in answer["states"]


def test_a_run_says_when_its_fault_began_and_what_became_of_each_axis(isocenter: Isocenter, tmp_path: Path) -> None:
    faults, truth = tmp_path / "faults.toml", tmp_path / "truth.csv"
    faults.write_text(RELEASED)
    outcome = isocenter(*SCAN, "-b", "lockstep:", "--faults", faults, "--truth", truth, "-o", tmp_path / "run.mf4")
    assert outcome.status == 1
    assert "hold-to-run was released" in outcome.line
    assert "hold_to_run_released at io begins at" in outcome.out
    assert "roll: at rest" in outcome.out
    assert "held by its brake" in outcome.out
    rows = truth.read_text().splitlines()[1:]
    assert float(rows[-1].split(",")[0]) - float(rows[0].split(",")[0]) > 1.0  # the truth goes on, the recording does not


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((*SCAN, "-b", "udp:", "-o", "run.mf4"), "give them to `isocenter emulate`"),
        (("emulate", "carm", "-b", "virtual:faults"), "only a run on lockstep: knows"),
        (("emulate", "--eds", "device.eds", "-b", "virtual:faults"), "--faults"),
    ],
)
def test_faults_that_nobody_can_make_are_refused(
    isocenter: Isocenter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nname = "imu_nan"\nwhen = "recording"\n')
    outcome = isocenter(*arguments, "--faults", faults)
    assert outcome.status == 2
    assert said in outcome.line


def test_the_check_writes_a_page_and_goes_on_where_it_was(isocenter: Isocenter, tmp_path: Path) -> None:
    arguments = ("faults", "check", "carm", "-o", tmp_path / "table", "--only", "door_opened")
    assert isocenter(*arguments).status == 0
    kept = (tmp_path / "table" / "outcomes.jsonl").read_text()
    outcome = isocenter(*arguments, "--json", tmp_path / "answer.json")
    assert outcome.status == 0
    assert "1 fault: 1 stopped" in outcome.out
    assert (tmp_path / "table" / "outcomes.jsonl").read_text() == kept
    assert "door_opened" in (tmp_path / "table" / "faults.html").read_text()
    assert json.loads((tmp_path / "answer.json").read_text()) == json.loads((tmp_path / "table" / "faults.json").read_text())


def test_what_was_left_moving_is_a_bad_answer(isocenter: Isocenter, tmp_path: Path) -> None:
    """Brakes that brake nothing, and a drive without power."""
    (tmp_path / "weak.toml").write_text(edited("^brake_effort_Nm = 800.0", "brake_effort_Nm = 0.1"))
    outcome = isocenter("faults", "check", tmp_path / "weak.toml", "-o", tmp_path, "--only", LOSES_POWER)
    assert outcome.status == 1
    assert f"{LOSES_POWER} moved on, went unnoticed" in outcome.line


def test_what_nothing_can_hold_is_told_as_that(isocenter: Isocenter, tmp_path: Path) -> None:
    outcome = isocenter("faults", "check", "carm", "-o", tmp_path, "--only", f"{LOSES_POWER}/without_brake")
    assert outcome.status == 0
    assert "1 fault: 1 cannot be held" in outcome.out
    assert "roll not proven at rest" in outcome.out
