"""`isocenter commission`: every step says what it found, a failed check ends it, and a mismatch leads to the next command."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command_line import Isocenter
from page_text import page_text

from hil.machine import load_machine
from hil.observing import read_design
from hil.recording import read_recording

COGGING = """[[effect]]
name = "cogging"
at = "turn"
Np_cycles_turn = 12.0
A1_Nm = 0.2
phi1_rad = 0.5
A2_Nm = 0.0
phi2_rad = 0.0
"""


@pytest.mark.slow
def test_a_machine_that_is_not_as_filed_is_told_and_the_next_command_names_its_files(
    tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hidden.toml").write_text(COGGING)
    done = isocenter("commission", "turntable", "-b", "lockstep:", "--effects", "hidden.toml", "-o", "arm", "--json", "arm.json")
    assert done.status == 0, done.err
    answer = json.loads(Path("arm.json").read_text())
    assert (answer["ok"], answer["comparison"]["agrees"], answer["comparison"]["noise"]) == (True, False, "repeats")
    assert answer["emulated"]
    assert "EMULATED: " in done.out
    assert answer["comparison"]["channels"]["position_turn"]["in_noise"] > 5.0
    (command,) = re.findall(r"isocenter diagnose turntable (.*)", done.out)
    given = command.split()
    last = done.out.splitlines()[-3:]
    assert last[0] == "turntable is commissioned: all 7 steps passed, but its simulation leaves something out."
    assert last[1] == "arm/index.html: the page"
    assert last[0] in page_text(Path("arm/index.html"))
    assert last[2] == f"next: {answer['next']}"
    files = [Path(word) for word in given if word.endswith(".mf4")]
    assert len(files) == 4
    repeats = [read_recording(path) for path in files[:3]]
    assert all(each.repeats(repeats[0]) for each in repeats)
    assert not read_recording(files[3]).repeats(repeats[0])
    assert given[given.index("--held-out") + 1] == str(files[3])


def test_a_controller_that_fails_its_check_is_not_run(tmp_path: Path, isocenter: Isocenter) -> None:
    text = load_machine("turntable").text
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(text.replace("constant = 0.095", "constant = 0.95"))
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "repeat1.mf4").write_text("of an arm that was commissioned before")
    done = isocenter("commission", wrong, "-b", "lockstep:", "-o", tmp_path / "arm", "--json", tmp_path / "arm.json")
    assert done.status == 1
    assert "FAIL check" in done.out
    assert "turntable is not commissioned: check failed: " in done.out
    assert done.out.splitlines()[-1] == f"next: isocenter machine check {wrong}"
    answer = json.loads((tmp_path / "arm.json").read_text())
    assert [step["name"] for step in answer["steps"]] == ["check"]
    assert answer["folder"] == f"{tmp_path / 'arm'}-2"
    assert [path.name for path in (tmp_path / "arm").iterdir()] == ["repeat1.mf4"]


def test_effects_on_a_bus_are_refused(tmp_path: Path, isocenter: Isocenter) -> None:
    effects = tmp_path / "hidden.toml"
    effects.write_text(COGGING)
    done = isocenter("commission", "turntable", "-b", "udp:", "--effects", effects, "-o", tmp_path / "arm")
    assert done.status == 2
    assert "--effects: only a run on lockstep: emulates" in done.line


@pytest.mark.slow
@pytest.mark.nightly
def test_the_hard_arm_is_commissioned_up_to_an_observer_that_was_held_to_truth(
    tmp_path: Path, isocenter: Isocenter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = isocenter("commission", "carm-real", "-b", "lockstep:", "--observer", "-o", "arm", "--json", "arm.json")
    assert done.status == 0, done.err
    last = json.loads(Path("arm.json").read_text())["steps"][-1]
    assert (last["name"], last["ok"]) == ("observe", True)
    assert any("held to the truth" in line for line in last["said"])
    assert read_design(Path("arm/carm-real.observer.npz")).machine == "carm-real"
