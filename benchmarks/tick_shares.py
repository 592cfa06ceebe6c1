"""What a tick of the bench spends its processor time on: shares of frames, observer, judges, IMU, I/O, recorder and supervisor.

    python benchmarks/tick_shares.py --prepared DIR

The bench runs the scan of `wall_clock.py` (shaper, observer, damping; emulator in another process, over UDP). A timer of the
process's own processor time interrupts it, as often as the kernel allows, and each time the innermost function that belongs to a part
of the bench names the part. Nothing is added to the tick but the interruptions. Waiting for the next tick is a part, since the loop
spins before it. The shares without waiting, times the median work of a tick, are microseconds a tick.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import subprocess
import tempfile
from collections import Counter
from pathlib import Path
from types import FrameType

import numpy as np
from wall_clock import BUS, DAMPING, ISOCENTER, SWEEP, SWEEP_S, prepared

from hil.cli import main as isocenter
from hil.recording import read_recording

RESULTS = Path(__file__).parent / "results" / "tick_shares.json"
SAMPLE_S = 0.5e-3  # a kernel of 250 Hz makes 4 ms of it
SECONDS = 120.0
LOOP = "/hil/bench/loop.py"
WAITING = "/hil/bench/clock.py"
PARTS = {
    "observer and damping": ("/hil/observing/", "/controllers/observers/", "/controllers/damping.py"),
    "judges of sensors": ("/drivers/judging/", "/hil/bench/judging.py", "/drivers/canopen/motion_bounds.py"),
    "IMU": ("/drivers/serial/",),
    "I/O": ("/drivers/modbus/", "/drivers/shared_memory/io_state.py"),
    "recorder": ("/hil/recording/", "/hil/bench/row_layout.py"),
    "supervisor": ("/drivers/supervisor/", "/drivers/supervisor_link/", "/drivers/shared_memory/"),
    "frames": ("/drivers/canopen/", "/drivers/udp_bus.py", "/drivers/ticking_machine.py", "/drivers/machine_link.py"),
    "feedback": ("/hil/bench/control.py", "/hil/bench/expected_motion.py", "/controllers/"),
}


class Sampler:
    """Counts the part at work whenever the timer interrupts the loop."""

    def __init__(self) -> None:
        self.counted: Counter[str] = Counter()

    def __call__(self, _: int, frame: FrameType | None) -> None:
        """Name the innermost part on the stack; outside the loop nothing counts."""
        part = ""
        while frame is not None:
            name = frame.f_code.co_filename
            if WAITING in name:  # the observer rehearses meanwhile
                part = "waiting"
            if not part:
                part = next((part for part, places in PARTS.items() if any(place in name for place in places)), "")
            if name.endswith(LOOP) and frame.f_code.co_name == "run":
                self.counted[part or "loop"] += 1
                return
            frame = frame.f_back


def measure(seconds: float, kept: Path) -> dict[str, object]:
    """Run the scan once and return the shares."""
    file = prepared(256.0, kept)
    rate = file.stem.removeprefix("carm_")
    words = ["run", "scan", "-m", str(file), "-b", BUS, "--pose", "roll=20", *SWEEP, "--sweeps", str(max(1, round(seconds / SWEEP_S)))]
    words += ["--shaper", str(file.with_name(f"roll_{rate}.npz")), "--observer", str(file.with_name(f"observer_{rate}.npz"))]
    words += ["--damping", DAMPING]
    sampler = Sampler()
    with tempfile.TemporaryDirectory() as folder:
        recorded = Path(folder) / "run.mf4"
        emulator = subprocess.Popen([*ISOCENTER, "emulate", str(file), "--bus", BUS], stdout=subprocess.PIPE, text=True)
        try:
            assert emulator.stdout is not None and emulator.stdout.readline(), "the emulator did not start"
            signal.signal(signal.SIGPROF, sampler)
            signal.setitimer(signal.ITIMER_PROF, SAMPLE_S, SAMPLE_S)
            with contextlib.suppress(SystemExit):
                isocenter([*words, "-o", str(recorded)])
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        finally:
            emulator.terminate()
            emulator.wait()
        if not recorded.exists():
            raise SystemExit("the scan was not recorded")
        work_us = float(np.median(read_recording(recorded)["work_time"])) * 1e6
    working = {part: count for part, count in sampler.counted.most_common() if part != "waiting"}
    whole = sum(working.values())
    return {
        "samples": whole,
        "median_work_us": work_us,
        "share": {part: count / whole for part, count in working.items()},
        "us_a_tick": {part: count / whole * work_us for part, count in working.items()},
    }


def main() -> None:
    """Run and write the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--prepared", type=Path, metavar="DIR", help="as `wall_clock.py` keeps them")
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="FILE")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        kept = arguments.prepared or Path(folder)
        kept.mkdir(parents=True, exist_ok=True)
        result = measure(arguments.seconds, kept)
    arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
