"""The observer on the wall clock, emulator and loop in two processes over UDP: a third reads along, and a replay repeats every bit."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.observing import ObserverDesign, observe, write_design
from hil.observing.board import LatestEstimate, latest_estimate
from hil.recording import read_recording

BUS = "udp:239.74.163.67"
ISOCENTER = [sys.executable, "-m", "hil"]
TIMEOUT_S = 120.0
LOOK_S = 0.05
PATIENT = {
    "heartbeat_s": 8.0,
    "master_heartbeat_s": 4.0,
    "boot_timeout_s": 20.0,
    "answer_timeout_s": '2.0\nanswers = "awaited"',
    "overrun_ticks": 5000,
    "stale_ticks": 64,
}
"""Time-outs that a machine busy with other things keeps; without the I/O, whose brakes have a second of their own."""


def read_along(run: subprocess.Popen[str]) -> LatestEstimate | None:
    """The last estimate anybody could see while the run went on."""
    seen = None
    while run.poll() is None:
        with contextlib.suppress(UnusableInputError):  # not there yet
            seen = latest_estimate(BUS)
        with contextlib.suppress(subprocess.TimeoutExpired):
            run.wait(LOOK_S)
    return seen


@pytest.mark.nightly
def test_estimates_are_published_recorded_and_repeated(machine: Machine, design: ObserverDesign, tmp_path: Path) -> None:
    text = re.sub(r"(?ms)^\[bus\.io\].*?(?=^\[|\Z)", "", machine.text)
    for key, value in PATIENT.items():
        text, found = re.subn(rf"(?m)^{key} = [0-9.]+", f"{key} = {value}", text)
        assert found, key
    (tmp_path / "patient.toml").write_text(text)
    write_design(design, tmp_path / "carm.observer.npz")
    emulate = [*ISOCENTER, "emulate", str(tmp_path / "patient.toml"), "--bus", BUS, "--no-real-time"]
    with subprocess.Popen(emulate, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as emulator:
        try:
            assert emulator.stdout is not None
            assert emulator.stdout.readline()
            run = [*ISOCENTER, "run", "static", "-m", str(tmp_path / "patient.toml"), "-b", BUS, "--seconds", "2", "--no-real-time"]
            options = ["--observer", str(tmp_path / "carm.observer.npz"), "-o", str(tmp_path / "still.mf4")]
            with subprocess.Popen([*run, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
                seen = read_along(running)
                said = running.communicate(timeout=TIMEOUT_S)
            assert running.returncode == 0, said
        finally:
            emulator.terminate()
            emulator.wait(TIMEOUT_S)
    recording = read_recording(tmp_path / "still.mf4")
    replayed = observe(recording, design.observer())
    assert recording.rows > 256  # a tick that was missed is no row
    assert np.array_equal(recording.matrix(replayed.names), replayed.values, equal_nan=True)
    assert seen is not None
    assert seen.names == replayed.names
    assert np.array_equal(seen.values, np.full(len(seen.names), np.nan) if seen.row < 0 else replayed.values[seen.row], equal_nan=True)
    with pytest.raises(UnusableInputError, match="no observer runs there"):
        latest_estimate(BUS)
