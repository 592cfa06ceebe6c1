"""Emulator and bench in two processes on the wall clock, over UDP multicast: it takes neither root nor a CAN driver (vcan: tests/vcan)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bench_machines import patient_text, read_truth

from hil.imaging.scan_folder import read_scan
from hil.recording import read_recording

BUS = "udp:239.74.163.61"
TIMEOUT_S = 120.0
ATTEMPTS = 3
"""On a computer that others use a limit of the machine file stops a run now and then, which may then stay to serve a hold."""


@pytest.fixture
def patient_carm(tmp_path: Path) -> Path:
    path = tmp_path / "patient.toml"
    path.write_text(patient_text())
    return path


def emulated_and_run(
    command: list[str], machine: Path, truth: Path, recorded: Path, images: Path
) -> subprocess.CompletedProcess[str] | None:
    """Run beside a fresh emulator; None where the run did not end."""
    emulator = subprocess.Popen(
        [
            *[*command, "emulate", str(machine), "--bus", BUS, "--pose", "roll=30", "--panel", "dodecahedron"],
            *["--truth", str(truth), "--no-real-time", "--json", "-"],
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    done: subprocess.CompletedProcess[str] | None = None
    try:
        assert emulator.stdout is not None
        assert emulator.stderr is not None
        line = emulator.stdout.readline()
        assert line, emulator.stderr.read()
        ready = json.loads(line)
        assert ready["ready"] == "carm"
        assert ready["bus"] == BUS
        assert ready["imu"]
        assert ready["io"].startswith("tcp:127.0.0.1:")
        assert ready["panel"].startswith("tcp:127.0.0.1:")
        run = [*command, "run", "static", "-m", str(machine), "-b", BUS, "--pose", "roll=30", "--seconds", "1", "--no-real-time"]
        run += ["--images", str(images), "--image-binning", "20"]
        given = [*run, "-o", str(recorded), "--json", "-"]
        done = subprocess.run(given, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        pass
    finally:
        emulator.terminate()
        said = emulator.communicate(timeout=TIMEOUT_S)
    assert emulator.returncode == 0, said
    return done


@pytest.mark.nightly
def test_a_run_over_udp_finds_the_emulators_ports_and_records_what_the_truth_says_and_what_the_panel_shows(
    patient_carm: Path, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "hil"]
    done: subprocess.CompletedProcess[str] | None = None
    for attempt in range(ATTEMPTS):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        truth, recorded, images = folder / "truth.csv", folder / "run.csv", folder / "images"
        done = emulated_and_run(command, patient_carm, truth, recorded, images)
        if done is not None and done.returncode == 0:
            break
        print(f"attempt {attempt}: {f'no end within {TIMEOUT_S:g} s' if done is None else done.stderr}", flush=True)
    else:
        pytest.fail("no run came to its end")
    assert done is not None
    (answer,) = json.loads(done.stdout)["recordings"]
    timing = answer["timing"]
    assert timing["lateness_max_us"] >= 0.0
    assert timing["work_time_p99_us"] > 0.0
    assert 0 < timing["ticks"] <= 256 <= timing["ticks"] + timing["missed"], "what a loaded computer skipped is counted"
    recording = read_recording(recorded)
    assert recording.rows == timing["ticks"]
    assert (recording["work_time"] > 0.0).all()
    # the IMU's time stamps are the emulated machine's time, in steps of 0.1 ms: they say which row of the truth a row is
    known = read_truth(truth)
    rows = np.flatnonzero(~recording.channel("imu_time").missing & ~recording.channel("position_roll").missing)
    assert len(rows) > recording.rows // 2
    nearest = np.array([np.argmin(np.abs(known["time"] - time_s)) for time_s in recording["imu_time"][rows]])
    assert np.abs(known["time"][nearest] - recording["imu_time"][rows]).max() < 2e-4
    assert recording["position_roll"][rows] == pytest.approx(known["joint_position_roll"][nearest], abs=1e-4)
    # the panel found by its emulator's card, each exposure in the loop's time by the SYNCs that both ends have counted
    scan = read_scan(images)
    assert list(scan.exposure_id) == list(range(len(scan)))
    assert 4 <= len(scan) <= 7
    assert scan.frame(3).max() > 1000
    assert scan.start_s[0] > 0.09
    assert scan.start_s[-1] <= recording.time[-1]
    assert scan.positions[:, 1] == pytest.approx(np.radians(30.0), abs=1e-3)
