"""How many times faster than real time the C-arm runs on lockstep, over the full CANopen stack, with serial IMU and Modbus I/O.

    python benchmarks/lockstep.py --json lockstep.json

The run is `isocenter run static`: emulated devices, drivers, loop, feedback and journal in one process; every frame, serial byte and
Modbus message is encoded and decoded. Wall time and processor time of the sample loop alone, several runs; quote the median on a
quiet machine. By turns with the runs, python-can alone sends SYNC, three frames up and two down over its `virtual` bus, as often as the
loop has ticks: `share_of_bare` compares the processor time of both.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np

from hil.bench.loop import PROGRESS_TICKS
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Static
from hil.machine import load_machine
from hil.terminal.output import Answer


def marking(marks: list[tuple[float, float]]) -> Callable[[int], None]:
    """A progress callback that notes wall and processor time."""
    return lambda row: marks.append((time.perf_counter(), time.process_time()))


def bare(ticks: int) -> float:
    """Return the processor time [s] in which python-can's `virtual` bus carries the frames of so many ticks."""
    up, down = (0x181, 0x182, 0x18B), (0x201, 0x202)
    with can.Bus(interface="virtual", channel="bare") as master, can.Bus(interface="virtual", channel="bare") as nodes:
        began_s = time.process_time()
        for _ in range(ticks):
            master.send(can.Message(arbitration_id=0x080, is_extended_id=False))
            nodes.recv(0.0)
            for sender, receiver, identifiers in ((nodes, master, up), (master, nodes, down)):
                for identifier in identifiers:
                    sender.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=bytes(8)))
                for _ in identifiers:
                    assert receiver.recv(0.0) is not None
        return time.process_time() - began_s


def measure(seconds: float, runs: int) -> dict[str, object]:
    """Times real time of `runs` runs of `seconds` of machine time each."""
    machine = load_machine("carm")
    plan = Static(seconds).plans(machine)[0]
    wall, processor, ticks, shares = [], [], [], []
    with tempfile.TemporaryDirectory() as folder, open_bench(machine, BenchOptions("lockstep:"), plan.start_pose) as bench:
        for run in range(runs):
            marks: list[tuple[float, float]] = []
            timing = bench.run(plan, Path(folder) / f"{run}.mf4", marking(marks))
            rows = (len(marks) - 1) * PROGRESS_TICKS / machine.sample_rate_Hz
            wall.append(rows / (marks[-1][0] - marks[0][0]))
            processor.append(rows / (marks[-1][1] - marks[0][1]))
            bare_s = bare(round(seconds * machine.sample_rate_Hz))
            shares.append(bare_s * processor[-1] / seconds)
            ticks.append(float(np.median(timing.work_time_s)) * 1e6)
    return {
        "machine": machine.name,
        "sample_rate_Hz": machine.sample_rate_Hz,
        "seconds_per_run": seconds,
        "times_real_time_wall": {"median": float(np.median(wall)), "runs": wall},
        "times_real_time_processor": {"median": float(np.median(processor)), "runs": processor},
        "share_of_bare": {"median": float(np.median(shares)), "runs": shares},
        "tick_median_us": float(np.median(ticks)),
    }


def main() -> None:
    """Print or write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="machine time per run")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", default="-", metavar="FILE", help="- for standard output")
    arguments = parser.parse_args()
    to = Answer(arguments.json)
    to.write(measure(arguments.seconds, arguments.runs))


if __name__ == "__main__":
    main()
