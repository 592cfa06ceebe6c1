"""Ten minutes of the C-arm at 256 Hz on the wall clock, emulator and loop in two processes: ticks missed, lateness, work time.

    python benchmarks/wall_clock.py --bus udp: --json wall_clock.json
    python benchmarks/wall_clock.py --bus socketcan:vcan0 --json -

The scheduler that was granted stands in the result: figures without SCHED_FIFO say more about the machine's other work than about the loop.
The machine file's limits of lost ticks and stale positions are lifted, so that a stall of the host is counted instead of ending the run.
`work_time` runs from the SYNC until the loop is ready to wait again; `answer_time` is the part of it spent waiting for the devices'
answers, `own_work_time` the rest. `host` is what the computer does to processes that do nothing else, under the same scheduler, before
the run: `lateness` of a loop without a bus, `computing`, how long 300 us of computing take at each tick, and `echo`, how long one UDP
datagram takes at each tick to a process that awaits it awake and back; `stolen_share` is the processor time that the hypervisor gave to
others during the run.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import re
import select
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hil.bench.clock import WallClock
from hil.machine import load_machine
from hil.processes.real_time import real_time
from hil.terminal.output import Answer
from virtual_bus.emulator import AWAKE_SHARE

ISOCENTER = [sys.executable, "-m", "hil"]
COMPUTING_S = 300e-6
RATE_Hz = 256.0
FLOOR_S = 20.0
ECHO_LOST_S = 10.0  # a loop at real-time priority does not look for one datagram for ever
GAP_S = 1e-6  # between two looks at the clock of a loop that nobody interrupts


def host_floor(seconds: float) -> dict[str, float]:
    """Percentiles [us] of `lateness`, `computing` and `echo`: see the head of this file."""
    clock = WallClock()
    lateness, computing = np.zeros(round(seconds * RATE_Hz)), np.zeros(round(seconds * RATE_Hz))
    with real_time():
        clock.start_ticks(1.0 / RATE_Hz)
        for k in range(len(lateness)):
            lateness[k] = clock.wait_tick()
            now_s = last_s = clock.tick_began_s
            computed_s = 0.0
            while computed_s < COMPUTING_S:  # a gap between two looks at the clock is time in which something else ran
                now_s, before_s = time.perf_counter(), now_s
                computed_s += min(now_s - before_s, GAP_S)
            computing[k] = now_s - last_s
    return percentiles({"lateness": lateness, "computing": computing, "echo": echoes(seconds)})


def percentiles(measured: dict[str, np.ndarray]) -> dict[str, float]:
    """Of each row of seconds, in microseconds."""
    table: dict[str, float] = {}
    for name, values in measured.items():
        p50, p99, p999 = np.percentile(values, [50.0, 99.0, 99.9]) * 1e6
        table |= {f"{name}_p50_us": p50, f"{name}_p99_us": p99, f"{name}_p99.9_us": p999, f"{name}_max_us": values.max() * 1e6}
    return table


def echoes(seconds: float) -> np.ndarray:
    """Seconds from each tick until a datagram has come back from a process that looks for it, like the emulator, before the tick is due."""
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind(("127.0.0.1", 0))
    other = multiprocessing.get_context("spawn").Process(target=_echo, args=(line.getsockname(),), daemon=True)
    other.start()
    line.settimeout(ECHO_LOST_S)
    _, address = line.recvfrom(16)
    line.setblocking(False)
    clock, took = WallClock(), np.zeros(round(seconds * RATE_Hz))
    with real_time():
        clock.start_ticks(1.0 / RATE_Hz)
        for k in range(len(took)):
            clock.wait_tick()
            line.sendto(b"x", address)
            while not _came(line):
                if time.perf_counter() - clock.tick_began_s > ECHO_LOST_S:
                    raise TimeoutError(f"no echo of a datagram on this host within {ECHO_LOST_S:g} s")
            took[k] = time.perf_counter() - clock.tick_began_s
    line.sendto(b"", address)
    other.join()
    line.close()
    return took


def _came(line: socket.socket) -> bool:
    try:
        return bool(line.recv(16))
    except BlockingIOError:
        return False


def _echo(address: tuple[str, int]) -> None:
    """Until an empty datagram comes."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line, real_time():
        line.connect(address)
        line.send(b"ready")
        line.setblocking(False)
        while True:
            try:
                if not line.recv(16):
                    return
            except BlockingIOError:
                continue
            line.send(b"x")
            select.select([line], [], [], (1.0 - AWAKE_SHARE) / RATE_Hz)  # after a late tick the next datagram comes early, and wakes it


def processor_times() -> tuple[int, int]:
    """Processor time stolen by the hypervisor, and all there was, since the computer was started; zeros where it does not say."""
    try:
        times = [int(cell) for cell in Path("/proc/stat").read_text().split("\n")[0].split()[1:9]]
    except (OSError, ValueError):
        return 0, 0
    return times[7], sum(times)


def measure(bus: str, seconds: float) -> dict[str, object]:
    """One run of `seconds` on `bus`."""
    with tempfile.TemporaryDirectory() as folder:
        machine = Path(folder) / "carm.toml"
        machine.write_text(re.sub(r"(?m)^(overrun|stale)_ticks = \d+", r"\1_ticks = 10000", load_machine("carm").text), encoding="utf-8")
        floor = host_floor(FLOOR_S)
        stolen, all_of_it = processor_times()
        emulator = subprocess.Popen([*ISOCENTER, "emulate", str(machine), "--bus", bus], stdout=subprocess.PIPE, text=True)
        try:
            assert emulator.stdout is not None and emulator.stdout.readline(), "the emulator did not start"
            answer = Path(folder) / "answer.json"
            run_static = ["run", "static", "-m", str(machine), "-b", bus, "--seconds", str(seconds), "-o", f"{folder}/run.mf4"]
            subprocess.run([*ISOCENTER, *run_static, "--json", str(answer)], check=True)
            run = json.loads(answer.read_text())
        finally:
            emulator.terminate()
            emulator.wait()
        stolen, all_of_it = (after - before for after, before in zip(processor_times(), (stolen, all_of_it), strict=True))
    return {
        "bus": bus,
        "seconds": seconds,
        "scheduler": run["scheduler"],
        "processors": os.cpu_count(),
        "load_average": os.getloadavg(),
        "kernel": platform.release(),
        "host": floor | {"stolen_share": stolen / max(all_of_it, 1)},
        "timing": run["recordings"][0]["timing"],
    }


def main() -> None:
    """Print or write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bus", default="udp:", help="bus URL")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--json", default="-", metavar="FILE", help="- for standard output")
    arguments = parser.parse_args()
    to = Answer(arguments.json)
    to.write(measure(arguments.bus, arguments.seconds))


if __name__ == "__main__":
    main()
