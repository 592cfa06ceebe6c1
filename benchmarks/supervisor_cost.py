"""What the supervisor costs the sample loop: whole tick and missed ticks with and without it, over two processes on UDP.

The emulated C-arm stands under control at 256 Hz, in short runs in pairs: one with the supervisor's process and one without, the order
turned from pair to pair, so that what else the computer does meets both alike. A bench without a supervisor does not exist: here alone its
place is taken by nothing, and the I/O's poller answers the device's watchdog itself. A whole tick lasts from the SYNC until the loop is
ready to wait again. The machine file's limits of lost ticks are lifted, so that a stall of the host is counted instead of ending the run.

    python benchmarks/supervisor_cost.py
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

BUS = "udp:239.74.163.203"
ISOCENTER = [sys.executable, "-m", "hil"]
HOW, COUNTED = "SUPERVISOR_COST", "SUPERVISOR_COST_COUNTED"
WITH, WITHOUT = "with", "without"
SHARES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}


def leave_it_out_of_the_poller() -> None:
    """Let the poller answer the device's watchdog by itself."""
    from drivers.modbus import io_process
    from drivers.modbus.refresh import following_word

    class Answers:
        def __init__(self, memory_name: str) -> None: ...

        def __call__(self, state: io_process.IoState) -> int:
            return following_word(state.word)

        def close(self) -> None: ...

    io_process.AnswerReader = Answers


def loop() -> None:
    """Run the bench's command line in this process, with or without a supervisor."""
    from drivers.supervisor_link.process import SupervisorProcess
    from hil.bench import wiring
    from hil.cli import main as isocenter

    class Counted(SupervisorProcess):
        """One whose processor time is counted from session to end."""

        def _spent_s(self) -> float:
            assert self._process is not None
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
            return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

        def begin(self) -> None:
            super().begin()
            self.began_s, self.spent_s = time.monotonic(), self._spent_s()

        def end(self) -> None:
            share = (self._spent_s() - self.spent_s) / (time.monotonic() - self.began_s)
            Path(os.environ[COUNTED]).write_text(f"{share:.4f}")
            super().end()

    class Nobody:
        memory_name = "nobody"

        def __init__(self, *_: object) -> None: ...

        def tapped(self, bus: object) -> object:
            return bus

        def start(self, io_memory: str = "") -> None: ...

        def begin(self) -> None: ...

        def end(self) -> None: ...

        def ticks_begin(self) -> None: ...

        def close(self) -> None: ...

        def trouble(self) -> str:
            return ""

    wiring.SupervisorProcess = Counted if os.environ[HOW] == WITH else Nobody
    isocenter()


def run(how: str, machine: Path, seconds: float, folder: Path) -> dict[str, object]:
    """Return timing and whole ticks [s] of one run."""
    from hil.recording import RecordingWarning, read_recording

    warnings.simplefilter("ignore", RecordingWarning)  # missed ticks are counted
    emulator = subprocess.Popen([*ISOCENTER, "emulate", str(machine), "--bus", BUS], stdout=subprocess.PIPE, text=True)
    answer, recorded, counted = folder / "answer.json", folder / "run.mf4", folder / "counted.txt"
    for left in (recorded, answer):
        left.unlink(missing_ok=True)
    try:
        assert emulator.stdout is not None and emulator.stdout.readline(), "the emulator did not start"
        words = ["run", "static", "-m", str(machine), "-b", BUS, "--seconds", str(seconds), "-o", str(recorded), "--json", str(answer)]
        environment = {**os.environ, HOW: how, COUNTED: str(counted), "PYTHONPATH": str(Path(__file__).parents[1])}
        subprocess.run([sys.executable, __file__, *words], env=environment, check=False)  # 1: a sensor was late, on a busy computer
    finally:
        emulator.terminate()
        emulator.wait()
    said = json.loads(answer.read_text())
    whole = read_recording(recorded)["work_time"]
    return {
        "scheduler": said["scheduler"],
        "missed": said["recordings"][0]["timing"]["missed"],
        "whole_tick_s": whole[np.isfinite(whole)],
        "share": float(counted.read_text()) if how == WITH else 0.0,
    }


def percentiles(whole_tick_s: np.ndarray) -> dict[str, float]:
    """Of whole ticks, in microseconds."""
    return {f"{name}_us": round(float(np.percentile(whole_tick_s, share)) * 1e6, 1) for name, share in SHARES.items()}


def spread(values: list[float]) -> dict[str, float]:
    """The median, the smallest and the largest."""
    return {"median": round(float(np.median(values)), 3), "smallest": round(min(values), 3), "largest": round(max(values), 3)}


def measure(pairs: int, seconds: float, results: Path) -> None:
    """Run the pairs, and keep what is known after each."""
    from hil.machine import load_machine

    rows, ticks = [], {WITH: [], WITHOUT: []}
    with tempfile.TemporaryDirectory() as name:
        machine = Path(name) / "carm.toml"
        machine.write_text(re.sub(r"(?m)^(overrun|stale)_ticks = \d+", r"\1_ticks = 10000", load_machine("carm").text), encoding="utf-8")
        for pair in range(pairs):
            row: dict[str, object] = {"load_average": Path("/proc/loadavg").read_text().strip()}
            for how in (WITH, WITHOUT) if pair % 2 == 0 else (WITHOUT, WITH):
                made = run(how, machine, seconds, Path(name))
                ticks[how].append(made["whole_tick_s"])
                row[how] = {"ticks": len(made["whole_tick_s"]), "missed": made["missed"], **percentiles(made["whole_tick_s"])}
                if how == WITH:
                    row["processor_share"] = made["share"]
            rows.append(row)
            print(json.dumps(row), flush=True)
            known = {
                "seconds": seconds,
                "scheduler": made["scheduler"],
                "processors": os.cpu_count(),
                **summary(rows, ticks),
                "pairs": rows,
            }
            results.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def summary(rows: list[dict], ticks: dict[str, list[np.ndarray]]) -> dict[str, object]:
    """All runs together, and what the pairs differ by."""
    together = {
        how: {
            "ticks": sum(map(len, ticks[how])),
            "missed": sum(row[how]["missed"] for row in rows),
            **percentiles(np.concatenate(ticks[how])),
        }
        for how in (WITH, WITHOUT)
    }
    return {
        "together": together,
        "ratio": {each: spread([row[WITH][f"{each}_us"] / row[WITHOUT][f"{each}_us"] for row in rows]) for each in SHARES},
        "added_us": {each: spread([row[WITH][f"{each}_us"] - row[WITHOUT][f"{each}_us"] for row in rows]) for each in SHARES},
        "processor_share": spread([row["processor_share"] for row in rows]),
    }


def main() -> None:
    """Write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run")
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results" / "supervisor_cost.json")
    arguments = parser.parse_args()
    measure(arguments.pairs, arguments.seconds, arguments.results)


if os.environ.get(HOW) == WITHOUT:
    leave_it_out_of_the_poller()  # at the import: the poller's process imports this file, too
if __name__ == "__main__":
    loop() if HOW in os.environ else main()
