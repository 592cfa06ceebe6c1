"""The whole stack on vcan0, emulator and loop in two processes: it runs, and its frames are those of a lockstep run."""

from __future__ import annotations

import re
import select
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from at_rest import AT_REST, SHIPPED
from conversation import conversations, differing, since_the_bench_came
from in_lockstep import answered_in_lockstep, answers
from processes import Done, start
from runs import ATTEMPTS, TOLD, by_a_limit, late_answers, timing_told, told_wake_ups, why_it_ended
from witnesses import Candump

from hil.machine import Machine, load_machine
from hil.recording import read_recording

pytestmark = pytest.mark.vcan

TIMEOUT_S = 300.0
STOPPED_S = 30.0
DRIVES, EMERGENCY, MASTER_IS_GONE, NMT_STOP = (1, 2), 0x080, b"\x30\x81", 2
"""A drive says that its master is gone, unless the supervisor, which waits as long for a SYNC, has stopped its node before."""


def test_frames_have_kind_and_order_of_a_lockstep_run_node_by_node(
    interface: str,
    lockstep_as_shipped: list[str],
    emulate: Callable[..., dict[str, str]],
    run: Callable[..., Done],
    candump: Callable[[str], Candump],
    folder: Path,
    tmp_path: Path,
) -> None:
    machine, bus = load_machine(SHIPPED), f"socketcan:{interface}"
    in_lockstep = conversations(lockstep_as_shipped, machine)
    assert {len(ticks) > 256 * 7 for ticks in in_lockstep.values()} == {True}
    for attempt in range(ATTEMPTS):
        witness, answer = candump(interface), tmp_path / f"answer_{attempt}.json"
        emulate(SHIPPED, "--bus", bus, "--seed", "3")
        out = ("--json", str(answer), "-o", str(tmp_path / f"{attempt}.mf4"))
        done = run(*AT_REST, "--machine", SHIPPED, "--bus", bus, *out)
        seen = conversations(since_the_bench_came(witness.frames()), machine)
        if not answer.exists():
            assert done.returncode == 1
            assert "Traceback" not in done.stderr
            said = why_it_ended(done, answer)
            assert by_a_limit(said), said
            assert re.search(r"propeller.* at rest: |held by|nobody knows|^sensors not to be believed", said), said  # what became of it
            print(f"attempt {attempt}: {said}", flush=True)
            continue
        late = late_answers(answer)
        differ = {node: differing(seen[node], ticks, late.get(node, 0)) for node, ticks in in_lockstep.items()}
        if not any(differ.values()):
            break
        print(f"attempt {attempt}: {differ}, {done.stderr}", flush=True)
    else:
        pytest.fail("no run on vcan0 had the conversations of the lockstep run")
    with (folder / TOLD).open("a") as told:
        told.write(f"{told_wake_ups(machine.sample_rate_Hz)}\n{timing_told(answer)}; frames as in lockstep\n")


@pytest.mark.nightly
def test_devices_answer_as_in_lockstep_to_the_same_frames_byte_for_byte(
    interface: str,
    emulate: Callable[..., dict[str, str]],
    run: Callable[..., Done],
    candump: Callable[[str], Candump],
    tmp_path: Path,
) -> None:
    """What is late on vcan, or stops a run, is in its frames. Stopped runs count, too.

    For every change kind and order of a run's frames are compared, and the bytes of frames by themselves.
    """
    file = can_alone(load_machine(SHIPPED), tmp_path)
    machine = load_machine(file)
    answered = 0
    for attempt in range(ATTEMPTS):
        witness = candump(interface)
        emulate(file, "--bus", f"socketcan:{interface}", "--seed", "3")
        done = run(*AT_REST, "--machine", file, "--bus", f"socketcan:{interface}", "-o", str(tmp_path / f"alone_{attempt}.mf4"))
        stamped = witness.stamped_frames()
        on_vcan = answers([frame for _, frame in stamped], machine)
        in_lockstep = answers(answered_in_lockstep(stamped, machine, 3), machine)
        if on_vcan == in_lockstep:
            answered += len(on_vcan.get("181", []))
        if answered > 7 * 256:
            return
        unlike = {name: len(said) for name, said in on_vcan.items() if said != in_lockstep.get(name)}
        print(f"attempt {attempt}: {len(stamped)} frames, unlike those of lockstep {unlike}, {done.stderr}", flush=True)
    pytest.fail(f"of all runs on vcan0, {answered} of the first drive's answers are in runs that were answered as in lockstep")


def can_alone(machine: Machine, folder: Path) -> str:
    """A machine without Modbus I/O and serial IMU, whose answers come when they come: what is left is on the CAN bus, frame after frame."""
    path = folder / "can_alone.toml"
    path.write_text(re.sub(r"(?ms)^\[(bus\.(io|imu)|budgets|judging)\b.*?(?=^\[|\Z)", "", machine.text))
    return str(path)


def test_a_loop_killed_mid_run_leaves_a_machine_that_stops_and_a_recording_that_reads(
    interface: str, emulate: Callable[..., dict[str, str]], tmp_path: Path
) -> None:
    emulate(SHIPPED, "--bus", f"socketcan:{interface}")
    bench = ("--machine", SHIPPED, "--bus", f"socketcan:{interface}", "--no-real-time")
    for attempt in range(ATTEMPTS):
        path = tmp_path / f"killed_{attempt}.mf4"
        loop = start(tmp_path, "run", "static", *bench, "--seconds", "60", "-o", str(path))
        part = path.with_name(path.name + ".part")
        while loop.process.exitcode is None and not (part.exists() and part.stat().st_size > 100_000):
            time.sleep(0.1)
        if loop.process.exitcode is None:
            break
        said = why_it_ended(loop.wait(), tmp_path / "none")
        assert by_a_limit(said), said
    else:
        pytest.fail("no run came so far")
    with can.Bus(interface, interface="socketcan") as bus:
        loop.process.kill()
        loop.wait()
        give_up = time.monotonic() + STOPPED_S
        stopped: set[int] = set()
        while len(stopped) < len(DRIVES):
            frame = bus.recv(1.0)
            assert time.monotonic() < give_up, f"stopped of nodes 1 and 2 were {stopped}"
            if frame is None:
                continue
            if frame.arbitration_id - EMERGENCY in DRIVES and frame.data[:2] == MASTER_IS_GONE:
                stopped.add(frame.arbitration_id - EMERGENCY)
            if frame.arbitration_id == 0 and frame.data[0] == NMT_STOP:
                stopped.add(frame.data[1])
    deadline = time.monotonic() + TIMEOUT_S
    while part.exists():
        assert time.monotonic() < deadline, "the recorder did not finish the recording of a dead loop"
        select.select([], [], [], 0.05)
    assert read_recording(path).rows > 128
