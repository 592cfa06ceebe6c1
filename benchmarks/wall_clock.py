"""Ten minutes of the C-arm at 256 Hz on the wall clock, emulator and loop in two processes: ticks missed, lateness, work time.

    python benchmarks/wall_clock.py --bus udp: --json wall_clock.json
    python benchmarks/wall_clock.py --bus socketcan:vcan0 --json -

The scheduler that was granted stands in the result: figures without SCHED_FIFO say more about the machine's other work than about the loop.
The machine file's overrun limit is lifted, so that a stall of the host is counted instead of ending the run.
`work_time` runs from the SYNC until the loop is ready to wait again; `answer_time` is the part of it spent waiting for the devices'
answers.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from hil.machine import load_machine

ISOCENTER = [sys.executable, "-m", "hil"]


def measure(bus: str, seconds: float) -> dict[str, object]:
    """One run of `seconds` on `bus`."""
    with tempfile.TemporaryDirectory() as folder:
        machine = Path(folder) / "carm.toml"
        machine.write_text(re.sub(r"(?m)^overrun_ticks = \d+", "overrun_ticks = 10000", load_machine("carm").text), encoding="utf-8")
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
    return {
        "bus": bus,
        "seconds": seconds,
        "scheduler": run["scheduler"],
        "processors": os.cpu_count(),
        "load_average": os.getloadavg(),
        "kernel": platform.release(),
        "timing": run["recordings"][0]["timing"],
    }


def main() -> None:
    """Print or write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bus", default="udp:", help="bus URL")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--json", default="-", metavar="FILE", help="- for standard output")
    arguments = parser.parse_args()
    text = json.dumps(measure(arguments.bus, arguments.seconds), indent=2)
    if arguments.json == "-":
        sys.stdout.write(text + "\n")
    else:
        Path(arguments.json).write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
