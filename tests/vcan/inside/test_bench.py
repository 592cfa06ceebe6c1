"""The whole stack on vcan0, emulator and loop in two processes: it runs, and its frames are those of a lockstep run."""

from __future__ import annotations

import json
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from hil.machine import load_machine
from hil.recording import read_recording

pytestmark = pytest.mark.vcan

ISOCENTER = [sys.executable, "-m", "hil"]
TIMEOUT_S = 300.0
ATTEMPTS = 5
"""A user-mode kernel stalls now and then for so long that the emulated machine's time goes on: then it is not the same run."""


@pytest.fixture
def emulate() -> Iterator[Callable[..., dict[str, str]]]:
    """Start `isocenter emulate` with these arguments; it is ready when this returns its ready line."""
    running: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> dict[str, str]:
        for process in running:
            _end(process)
        process = subprocess.Popen(
            [*ISOCENTER, "emulate", "--no-real-time", "--json", "-", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        running.append(process)
        assert process.stdout is not None and process.stderr is not None
        line = process.stdout.readline()
        assert line, process.stderr.read()
        return json.loads(line)

    yield start
    for process in running:
        _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """`isocenter run ...` to its end."""
    return subprocess.run([*ISOCENTER, "run", *arguments, "--no-real-time"], capture_output=True, text=True, timeout=TIMEOUT_S, check=False)


def patient(tmp_path: Path, *, can_only: bool = False) -> str:
    """carm with time-outs that a user-mode kernel on a loaded machine keeps: there a second of the bus may take several.

    With `can_only` without Modbus I/O and serial IMU: what is left is on the CAN bus, where every frame is ordered.
    """
    text = load_machine("carm").text
    relaxed = {
        "heartbeat_s": 4.0,
        "master_heartbeat_s": 1.5,
        "boot_timeout_s": 20.0,
        "stale_after_s": 10.0,
        "answer_timeout_s": '0.5\nanswers = "awaited"',
        "overrun_ticks": '512\noverrun = "wait"',
    }
    for key, value in relaxed.items():
        text, found = re.subn(rf"(?m)^{key} = [0-9.]+", f"{key} = {value}", text)
        assert found, key
    if can_only:
        text = re.sub(r"(?ms)^\[bus\.(io|imu)\].*?(?=^\[|\Z)", "", text)
    path = tmp_path / "patient.toml"
    path.write_text(text)
    return str(path)


def since_the_bench_came(frames: list[str]) -> list[str]:
    """Without the boot-ups of a machine switched on before its bench connects: candump is there already, the lockstep log is not."""
    return frames[next(i for i, frame in enumerate(frames) if frame.startswith("000#")) :]


def test_multisine_with_jog_runs_and_is_recorded(interface, emulate, tmp_path):
    machine = patient(tmp_path)
    emulate(machine, "--bus", f"socketcan:{interface}", "--pose", "roll=30")
    path = tmp_path / "run.mf4"
    done = run(
        *(
            "multisine",
            "--machine",
            machine,
            "--bus",
            f"socketcan:{interface}",
            "--pose",
            "roll=30",
            "--experiments",
            "single",
            "--axes",
            "roll",
        ),
        *("--amplitude", "0.5", "--period", "2", "--jog", "0.2", "--periods", "1", "-o", str(path)),
    )
    assert done.returncode == 0, done.stderr
    recording = read_recording(path)
    ticks = recording["time"] * 256.0  # those that a loaded computer skipped are no rows
    assert ticks == pytest.approx(np.round(ticks), abs=1e-6) and (np.diff(ticks) > 0.5).all()
    assert recording.rows > 2 * 256 and ticks[-1] < 2 * 2 * 256
    arrived = np.isfinite(recording.channel("position_roll").values)
    assert arrived.mean() > 0.9, f"positions arrived in {arrived.mean():.1%} of the ticks"
    assert np.isfinite(recording.channel("imu_z").values).mean() > 0.9
    assert np.nanmax(np.abs(recording.channel("reference_roll").values - recording.channel("position_roll").values)) < np.radians(1.0)


def test_frames_are_those_of_a_lockstep_run_byte_for_byte(interface, emulate, candump, tmp_path):
    machine = patient(tmp_path, can_only=True)
    arguments = ("static", "--machine", machine, "--seconds", "1", "--seed", "3")
    log = tmp_path / "frames.log"
    done = run(*arguments, "--bus", "lockstep:", "--frame-log", str(log), "-o", str(tmp_path / "lockstep.mf4"))
    assert done.returncode == 0, done.stderr
    lockstep = since_the_bench_came([line.split()[2] for line in log.read_text().splitlines()])
    for attempt in range(ATTEMPTS):
        witness = candump(interface)
        emulate(machine, "--bus", f"socketcan:{interface}", "--seed", "3")
        path = tmp_path / f"vcan_{attempt}.mf4"
        done = run(*arguments, "--bus", f"socketcan:{interface}", "-o", str(path))
        seen = since_the_bench_came(witness.frames())
        if seen == lockstep:
            break
        both = zip(seen, lockstep, strict=False)
        first = next((i for i, (ours, theirs) in enumerate(both) if ours != theirs), min(len(seen), len(lockstep)))
        near = slice(max(0, first - 3), first + 5)
        print(f"attempt {attempt}: {len(seen)} frames on {interface}, {len(lockstep)} in lockstep, {done.stderr}", flush=True)
        print(f"  from frame {near.start}: {seen[near]} and {lockstep[near]}", flush=True)
    else:
        pytest.fail("no run on vcan0 had the frames of the lockstep run")
    assert len(lockstep) > 256 * 7


def test_a_loop_killed_mid_run_leaves_a_machine_that_stops_and_a_recording_that_reads(interface, emulate, tmp_path):
    machine = patient(tmp_path)
    emulate(machine, "--bus", f"socketcan:{interface}")
    path = tmp_path / "killed.mf4"
    loop = subprocess.Popen(
        [
            *ISOCENTER,
            "run",
            "static",
            "--machine",
            machine,
            "--bus",
            f"socketcan:{interface}",
            "--seconds",
            "60",
            "-o",
            str(path),
            "--no-real-time",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    part = path.with_name(path.name + ".part")
    with can.Bus(interface, interface="socketcan") as bus:
        while not (part.exists() and part.stat().st_size > 200_000):
            assert loop.poll() is None, loop.stderr.read() if loop.stderr else ""
            bus.recv(0.1)
        loop.kill()
        loop.wait()
        emergencies = set()
        while len(emergencies) < 2:
            frame = bus.recv(30.0)
            assert frame is not None, "the drives did not say that their master is gone"
            if frame.arbitration_id in (0x81, 0x82) and frame.data[:2] == b"\x30\x81":
                emergencies.add(frame.arbitration_id)
    deadline = time.monotonic() + TIMEOUT_S
    while part.exists():
        assert time.monotonic() < deadline, "the recorder did not finish the recording of a dead loop"
        select.select([], [], [], 0.05)
    assert read_recording(path).rows > 256
