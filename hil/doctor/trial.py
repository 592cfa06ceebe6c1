"""How punctual this computer is: wake-ups without a bus, and a run of the machine's own loop against its emulation in another process.

The trial is what `isocenter run static` does, on a UDP bus of its own on the loopback interface. Nothing is sent to, or opened of, the
machine: address of IMU and I/O are the emulator's, whatever the machine file says.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import select
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from hil.bench.clock import WallClock
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.timing import LoopTiming
from hil.emulated.card import find
from hil.errors import UnusableInputError
from hil.experiments import Static
from hil.machine import Machine
from hil.processes.real_time import real_time

GROUP = "239.74.163.250"
READY_S = 60.0
"""Longest wait for the emulator, which may compile the machine's plant first."""
END_S = 10.0
BORNE_TICKS = 100_000
"""Ticks lost or without a position that the trial bears: a stall of the host shall be counted, not end it."""


def wake_ups(period_s: float, seconds: float) -> np.ndarray:
    """Measure the lateness [s] of a loop that does nothing else, with the bench's clock and scheduler."""
    clock, lateness = WallClock(), np.zeros(max(round(seconds / period_s), 1))
    with real_time():
        clock.start_ticks(period_s)
        for k in range(len(lateness)):
            lateness[k] = clock.wait_tick()
    return lateness


def trial(machine: Machine, seconds: float, follow: Callable[[str], None]) -> LoopTiming:
    """Run the machine's loop against its emulation, and return its timing.

    Parameters
    ----------
    machine : Machine
    seconds : float
        Of the part that counts.
    follow : callable
        Takes what is being done, in words.

    Raises
    ------
    UnusableInputError
        The machine cannot be run, or its emulator did not start.
    BenchError, DriverError
        The run ended early.
    """
    if machine.bus is None or not machine.controllers:
        raise UnusableInputError(f"{machine.name}: its file has no [bus] or no [controller], so its loop cannot be run")
    patient = dataclasses.replace(machine, overrun_ticks=BORNE_TICKS, stale_ticks=BORNE_TICKS, needs_recorder=False)
    (plan,) = Static(seconds).plans(patient)
    with tempfile.TemporaryDirectory() as folder:
        follow("starting the emulated machine")
        with _emulator(machine, Path(folder)) as bus:
            card = find(bus)
            if card is None or (machine.bus.imu is not None and not card.imu_device) or (machine.bus.io is not None and not card.io_url):
                raise UnusableInputError(f"{machine.name}: its emulator does not say where its IMU and I/O are")
            follow("homing and standstill of the emulated machine, as before every run")
            with open_bench(patient, BenchOptions(bus, card.imu_device, card.io_url), plan.start_pose) as bench:
                return bench.run(plan, Path(folder) / "trial.mf4", lambda row: follow(f"{seconds:g} s of its loop") if row == 0 else None)


@contextlib.contextmanager
def _emulator(machine: Machine, folder: Path) -> Iterator[str]:
    """Emulate the machine in a process of its own, on a bus of its own; give the bus's URL."""
    bus = f"udp:{GROUP}@{_free_port()}"
    file = folder / "machine.toml"
    file.write_text(machine.text, encoding="utf-8")
    named = machine.path if machine.path is not None else file  # a file may name data sheets beside it
    words = [sys.executable, "-m", "hil", "emulate", str(named), "--bus", bus, "--json", "-"]
    with (folder / "emulator").open("w+", encoding="utf-8") as said:
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=said, text=True)
        assert process.stdout is not None
        answer = process.stdout
        try:
            came = sys.platform == "win32" or select.select([answer], [], [], READY_S)[0]
            line = answer.readline() if came else ""
            if not line:
                said.seek(0)
                last = (said.read().strip().splitlines() or [f"nothing within {READY_S:g} s"])[-1]
                raise UnusableInputError(f"{machine.name}: the emulator did not start: {last.removeprefix('isocenter: ')}")
            yield json.loads(line)["bus"]
        finally:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            answer.close()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def tick_times(timing: LoopTiming, answer_s: float | None = None) -> np.ndarray:
    """Return from when each tick was due until the loop was ready to wait again [s].

    Parameters
    ----------
    timing : LoopTiming
    answer_s : float, optional
        What a CAN bus takes for the answers, in place of what the emulator took.
    """
    answers_s = timing.answer_time_s if answer_s is None else np.full_like(timing.answer_time_s, answer_s)
    whole_s: np.ndarray = timing.lateness_s + (timing.work_time_s - timing.answer_time_s) + answers_s
    return whole_s
