"""A command does not write over a file that it reads: it says so before it reads anything."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import runner

COMMANDS = {
    "identify": ["identify", "read", "other", "-o", "read"],
    "observe": ["observe", "carm", "read", "-o", "read"],
    "observe, tuned": ["observe", "carm", "other", "--tune", "read", "-o", "read"],
    "observe, swept": ["observe", "carm", "other", "--multisine", "other", "--sweep", "read", "-o", "read"],
    "observe, designed": ["observe", "carm", "other", "--design", "read", "-o", "read"],
    "observe, design saved": ["observe", "carm", "read", "-o", "x.npz", "--save-design", "read"],
    "observe, drawn": ["observe", "carm", "other", "--design", "read", "-o", "x.npz", "--figure", "read"],
    "shape": ["shape", "carm", "--axis", "roll", "--frf", "read", "-o", "read"],
    "simulate": ["simulate", "carm", "read", "-o", "read"],
    "calibrate level": ["calibrate", "level", "carm", "other", "--by", "read", "-o", "read"],
    "calibrate model": ["calibrate", "model", "carm", "read", "-o", "read"],
    "geometry standing": ["geometry", "standing", "read", "-o", "read"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_read_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    kept = {"read": tmp_path / "read.mf4", "other": tmp_path / "other.mf4"}
    for path in kept.values():
        path.write_bytes(b"measured")
    outcome = runner(capsys)(*(kept.get(argument, argument) for argument in COMMANDS[command]))
    assert outcome.status == 2
    assert "is read by this command; write to another file" in outcome.line
    assert kept["read"].read_bytes() == b"measured"


@pytest.mark.parametrize("command", ["identify", "observe", "shape"])
def test_a_folder_that_is_not_there_is_said_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    arguments = [tmp_path / "x.npz" if argument == "read" else argument for argument in COMMANDS[command]]
    outcome = runner(capsys)(*arguments, "--figure", tmp_path / "no" / "f.png")
    assert outcome.status == 2
    assert "there is no folder" in outcome.line


def test_a_model_or_a_demo_that_could_not_be_written_is_refused_with_what_would_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome = runner(capsys)("machine", "export", "carm", "--mjcf", tmp_path / "no" / "carm.xml")
    assert outcome.status == 2
    assert f"there is no folder {tmp_path / 'no'}" in outcome.line
    (tmp_path / "file").write_text("kept")
    outcome = runner(capsys)("demo", "--out", tmp_path / "file")
    assert outcome.status == 2
    assert "is a file; give a folder" in outcome.line
    assert (tmp_path / "file").read_text() == "kept"
