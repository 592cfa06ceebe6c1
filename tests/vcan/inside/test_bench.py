"""The whole stack on vcan0, emulator and loop in two processes: it runs, and its frames are those of a lockstep run."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from patient import AT_REST, patient, since_the_bench_came
from processes import Done, start
from witnesses import Candump

from hil.recording import read_recording

pytestmark = [pytest.mark.vcan, pytest.mark.usefixtures("lockstep_frames")]

TIMEOUT_S = 300.0
ATTEMPTS = 5
"""A user-mode kernel stalls now and then for so long that the emulated machine's time goes on: then it is not the same run."""


def test_frames_are_those_of_a_lockstep_run_byte_for_byte(
    interface: str,
    emulate: Callable[..., dict[str, str]],
    run: Callable[..., Done],
    candump: Callable[[str], Candump],
    tmp_path: Path,
    lockstep_frames: list[str],
) -> None:
    machine, lockstep = patient(tmp_path, can_only=True), lockstep_frames
    for attempt in range(ATTEMPTS):
        witness = candump(interface)
        emulate(machine, "--bus", f"socketcan:{interface}", "--seed", "3")
        path = tmp_path / f"vcan_{attempt}.mf4"
        done = run(*AT_REST, "--machine", machine, "--bus", f"socketcan:{interface}", "-o", str(path))
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


def test_a_loop_killed_mid_run_leaves_a_machine_that_stops_and_a_recording_that_reads(
    interface: str, emulate: Callable[..., dict[str, str]], tmp_path: Path
) -> None:
    machine = patient(tmp_path)
    emulate(machine, "--bus", f"socketcan:{interface}")
    path = tmp_path / "killed.mf4"
    bench = ("--machine", machine, "--bus", f"socketcan:{interface}", "--no-real-time")
    loop = start(tmp_path, "run", "static", *bench, "--seconds", "60", "-o", str(path))
    part = path.with_name(path.name + ".part")
    with can.Bus(interface, interface="socketcan") as bus:
        while not (part.exists() and part.stat().st_size > 200_000):
            assert loop.process.exitcode is None, loop.wait().stderr
            bus.recv(0.1)
        loop.process.kill()
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
