"""A controller that `machine check` fails is not run, unless the user says so; then the recording says it, too."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import Isocenter

from hil.bench.margins import accepted_margins
from hil.errors import UnusableInputError
from hil.machine import load_machine
from hil.recording import read_recording

FAILS = "turn: phase margin at least 38.7 deg (at 5.26 Hz, turn -90 deg); at least 40 deg is right"
STILL = ("run", "static", "-b", "lockstep:", "--seconds", "0.2")


@pytest.fixture
def eager(tmp_path: Path) -> Path:
    """The turntable with twice its gain."""
    text, old = load_machine("turntable").text, "[94.9267984, -94.5696061"
    assert old in text
    path = tmp_path / "eager.toml"
    path.write_text(text.replace(old, "[190.0, -189.3"))
    return path


def test_a_controller_that_the_check_fails_is_refused_in_the_check_s_own_words(isocenter: Isocenter, eager: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.mf4"
    assert FAILS in isocenter("machine", "check", eager).out
    refused = isocenter(*STILL, "-m", eager, "-o", out)
    assert refused.status == 2
    assert FAILS in refused.line
    assert "--accept-margins" in refused.line
    assert not list(tmp_path.glob("run*"))


def test_who_accepts_it_finds_it_in_the_recording_and_its_events(isocenter: Isocenter, eager: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.mf4"
    ran = isocenter(*STILL, "-m", eager, "--accept-margins", "-o", out, "--json", "-")
    assert ran.status == 0
    assert json.loads(ran.out)["accepted_margins"] == [FAILS]
    metadata = read_recording(out).metadata
    assert metadata["bench"]["accepted_margins"] == [FAILS]
    (event,) = [each for each in metadata["events"] if each["what"] == "margins accepted"]
    assert (event["who"], event["failing"]) == ("operator", FAILS)


def test_where_nothing_fails_there_is_nothing_to_accept(isocenter: Isocenter, tmp_path: Path) -> None:
    out = tmp_path / "run.mf4"
    assert isocenter(*STILL, "-m", "turntable", "--accept-margins", "-o", out).status == 0
    assert "accepted_margins" not in read_recording(out).metadata["bench"]


def test_another_controller_in_a_machine_that_was_looked_at_is_looked_at(eager: Path) -> None:
    """What a process has found of a machine it finds again for this machine alone, whatever its file says."""
    machine = load_machine("turntable")
    assert accepted_margins(machine, False, "") == accepted_margins(machine, False, "") == ()
    with pytest.raises(UnusableInputError, match="phase margin"):
        accepted_margins(replace(machine, controllers=load_machine(eager).controllers), False, "")
