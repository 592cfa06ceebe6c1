"""`isocenter doctor` as its user sees it, and what it leaves alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bench_machines import CARM, edited, patient_text
from command_line import Isocenter

from hil.doctor import examine as examination
from hil.doctor import wire
from hil.doctor.examine import examine
from hil.doctor.trial import wake_ups

LEVELS = ("ok", "look", "bad", "not known")
TRIALS = 3
"""Tried at most: beside other tests the emulator may be kept from its processor for longer than a brake may take."""


@pytest.mark.slow
def test_the_loop_is_tried_on_an_emulated_machine_whatever_addresses_the_machine_file_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, isocenter: Isocenter
) -> None:
    """IMU and I/O of the file are not there: opened, they would end the trial. Benches of other tests are not looked for."""
    text = edited('^device = ""', 'device = "/dev/ttyNONE0"', patient_text())
    machine = tmp_path / "mine.toml"
    machine.write_text(edited('^url = ""', 'url = "tcp:192.0.2.7:502"', text))
    monkeypatch.setattr(wire, "benches", lambda root: 0)
    monkeypatch.chdir(tmp_path)
    for _ in range(TRIALS):
        outcome = isocenter("doctor", "-m", machine, "--seconds", 4.0, "--json", "-")
        assert outcome.status in (0, 1), outcome.err
        answer = json.loads(outcome.out)
        findings = {finding["check"]: finding for finding in answer["findings"]}
        if "not closed within" not in findings.get("trial", {}).get("found", ""):
            break
    assert "trial" not in findings, findings["trial"]
    assert answer["ok"] is (outcome.status == 0)
    assert answer["ok"] is all(finding["level"] != "bad" for finding in findings.values())
    assert {"kernel", "scheduler", "disk", "wake-up", "whole tick", "missed ticks"} <= set(findings)
    for finding in findings.values():
        assert finding["level"] in LEVELS
        assert finding["advice"] or finding["level"] in ("ok", "not known"), finding
        assert f"{finding['check']}: {finding['found']}" in outcome.err
    prediction = answer["prediction"]
    assert prediction["period_s"] == pytest.approx(1.0 / 256.0)
    assert 512 <= prediction["ticks"] <= 1024
    assert 1e-4 < prediction["p50_s"] <= prediction["p99_s"] <= prediction["p999_s"] <= prediction["max_s"]
    assert prediction["least_missed"] <= prediction["most_missed"]
    assert answer["trial"]["work_time_p50_us"] < 1e6 * prediction["max_s"]
    assert "4 s of its loop" in outcome.err, "progress is told"
    assert list(tmp_path.iterdir()) == [machine], "nothing is left behind"


def test_where_a_bench_runs_nothing_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("measured beside a bench that runs")

    monkeypatch.setattr(examination, "wake_ups", never)
    monkeypatch.setattr(examination, "trial", never)
    (tmp_path / "proc/net").mkdir(parents=True)
    (tmp_path / "proc/net/unix").write_text("0: 0 0 0 1 1 7 /run/user/1/isocenter-1/stop-0123456789abcdef.socket\n")
    found = examine(CARM, "udp:", 10.0, tmp_path, lambda text: None, tmp_path)
    assert found.prediction is None
    assert found.findings[-1].check == "in use"
    assert "1 bench runs" in found.findings[-1].found
    assert {one.check: one.level for one in found.findings}["disk"] == "not known"


def test_wake_ups_are_as_many_as_there_are_ticks() -> None:
    late = wake_ups(0.002, 0.1)
    assert late.shape == (50,)
    assert (late >= 0.0).all()
    assert np.median(late) < 0.05


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-b", "lockstep:"], "give the machine's bus, or udp:"),
        (["-b", "virtual:x"], "give the machine's bus, or udp:"),
        (["-b", "nonsense"], "INTERFACE:CHANNEL"),
        (["--seconds", "0.5"], "--seconds 0.5: must be 4 to 3600"),
        (["-m", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_unusable_input_is_refused_before_anything_is_measured(isocenter: Isocenter, words: list[str], said: str) -> None:
    outcome = isocenter("doctor", *words)
    assert outcome.status == 2
    assert said in outcome.line
