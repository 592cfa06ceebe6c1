"""What a new user meets in the first sitting: units, refusals, and answers that say yes or no."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_line import Isocenter
from places import ROOT

import hil
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from hil.doctor.examine import Examination
from hil.doctor.finding import Finding
from hil.errors import UnusableInputError
from hil.machine import load_machine
from hil.observing import emulated_design
from hil.shaping.in_time import after_step, in_time_lines

RATE_Hz = 256.0


@pytest.mark.parametrize(
    "words",
    [
        ("scan", "--axis", "turn", "--from", "0", "--to", "2000"),
        ("static", "--pose", "turn=2000"),
        ("jog", "--amplitude", "2000"),
    ],
)
def test_a_position_beyond_the_range_is_refused_in_degrees(isocenter: Isocenter, tmp_path: Path, words: tuple[str, ...]) -> None:
    said = isocenter("run", *words, "-m", "turntable", "-b", "lockstep:", "-o", tmp_path / "x.mf4").line
    limit = load_machine("turntable").limits[0]
    assert f"{np.degrees(limit.lower):.4g}" in said
    assert re.search(r"\d deg\b", said)
    assert not re.search(r"\d rad\b", said)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("shape", "carm", "--axis", "roll"), ("identify", "nosuch.mf4")])
def test_a_result_goes_to_a_file_of_its_kind(isocenter: Isocenter, tmp_path: Path, words: tuple[str, ...]) -> None:
    assert "must end in .npz" in isocenter(*words, "-o", tmp_path / "x.foo").line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("levels", "tried", "answer"),
    [
        (("ok", "ok"), True, "Yes: this computer runs the loop of carm at 256 Hz (2 ok, 0 look, 0 bad, 0 not known)"),
        (("ok", "look"), True, "Yes: this computer runs the loop of carm at 256 Hz; better with check 1 mended (1 ok, 1 look"),
        (("look", "bad"), True, "No: this computer does not run the loop of carm at 256 Hz, or not for long: check 1: found 1 ("),
        (("ok", "not known"), False, "Not known: the loop of carm at 256 Hz was not tried (1 ok, 0 look, 0 bad, 1 not known)"),
    ],
)
def test_doctor_says_yes_or_no(levels: tuple[str, ...], tried: bool, answer: str) -> None:
    findings = tuple(Finding(level, f"check {n}", f"found {n}") for n, level in enumerate(levels))  # type: ignore[arg-type]
    examination = Examination(findings, None, None, {"ticks": 1.0} if tried else None, "")
    assert examination.sentence(load_machine("carm")).startswith(answer)


def test_a_shaper_whose_step_overshoots_says_why() -> None:
    """A first-order loop trails a ramp by its time constant; taps of 1.5 and -0.5, 0.1 s apart, lead by 0.05 s."""
    decay, pole = 0.02, np.exp(-1.0 / RATE_Hz / 0.02)
    loop = Dynamics(np.array([[pole]]), np.array([1.0 - pole]), np.array([1.0]), 0.0, 1.0 / RATE_Hz)
    none = after_step(loop, DelayFilter(np.zeros(1), np.ones(1)), RATE_Hz)
    leading = after_step(loop, DelayFilter(np.array([0.0, 0.1015625]), np.array([1.5, -0.5])), RATE_Hz)
    assert none.overshoot == pytest.approx(0.0, abs=1e-9)
    assert none.ramp_lag_s == pytest.approx(decay, abs=1.0 / RATE_Hz)
    assert leading.ramp_lag_s == pytest.approx(none.ramp_lag_s - 0.5 * 0.1015625, abs=1e-9)
    assert leading.overshoot == pytest.approx(0.5, abs=0.01)
    assert any(re.search(r"overshoots by 49\.\d % *, by 0 % without.* ramp", line) for line in in_time_lines(none, leading, "leading"))
    assert not any("overshoots" in line for line in in_time_lines(none, none, "none"))


def test_a_folder_named_by_text_is_read_as_one(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match=r"holds scan\.toml"):
        hil.read_scan(str(tmp_path))


def test_a_machine_that_is_not_there_is_refused_before_anything_heavy_is_imported() -> None:
    asked = "import sys\nfrom hil.cli import main\ntry:\n    main(['machine', 'check', 'nosuch'])\nfinally:\n    print(*sys.modules)"
    told = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=False, cwd=ROOT)
    assert told.returncode == 2
    assert told.stderr.startswith("isocenter: nosuch: ")
    assert not {"hil.machine.check", "scipy.signal", "canopen", "numba"} & set(told.stdout.split())


def test_a_machine_that_cannot_be_observed_is_refused_before_it_is_measured() -> None:
    told: list[tuple[int, int]] = []
    with pytest.raises(UnusableInputError, match=r"turntable: its file has no \[geometry\]"):
        emulated_design(load_machine("turntable"), modes=4, told=lambda done, total: told.append((done, total)))
    assert told == []


@pytest.mark.nightly
def test_an_observer_s_design_says_how_much_is_measured() -> None:
    told: list[tuple[int, int]] = []
    emulated_design(load_machine("carm"), modes=4, told=lambda done, total: told.append((done, total)))
    (total,) = {total for _, total in told}
    assert [done for done, _ in told] == list(range(total + 1))


@pytest.mark.nightly
def test_the_example_of_the_readme_prints_a_few_lines_that_say_something(tmp_path: Path) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    told = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True, check=True, cwd=tmp_path)
    lines = told.stdout.splitlines()
    assert 1 <= len(lines) <= 10
    assert all(re.match(r"\d[\d.]* Hz", line) for line in lines)
