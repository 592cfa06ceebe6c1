"""What becomes of the most dangerous faults over two processes on UDP, beside the row of the same fault in lockstep.

`isocenter emulate` has the fault, `isocenter run` the sweep of the table of faults; nothing is between them but the bus, IMU and I/O. The
verdict is from what the run said and from the emulator's truth. A run that the computer broke off, because other work kept the loop from
its ticks, counts for nothing and is made again. Ended early, the script goes on where it was. One command:

    python benchmarks/faults_over_processes.py
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from most_dangerous import MOST_DANGEROUS

from hil.faults.motion import standard_scan
from hil.faults.trials import FAST_SHARE, FaultTrial, trials
from hil.machine import Machine, load_machine
from hil.machine.faults_file import faults_text

GROUP = "239.74.163.202"
RESULTS = Path(__file__).parent / "results"
ATTEMPTS = 4
STILL_SPEED = 1e-3  # rad/s, as the table of faults has it
REST_S = 1.0
WATCHED_S = 3.0
"""For which the emulator goes on without a bench: an arm that nobody holds falls by a metre and more."""
RUN_AT_MOST_S = 240.0
TRUTH = "truth.csv"
HELD = "held by its drive"
NOT_YET = {"verdict": "never began"}
THE_COMPUTERS = re.compile(r"no position for \d+ ticks|the loop lost \d+ ticks in a row|no answer to \d+ SYNCs|no SYNC for [\d.]+ s while")


@dataclass(frozen=True)
class OverProcesses:
    """What became of one fault over two processes."""

    verdict: str  # "stopped", "noted", "unnoticed", "not at rest", "never began"
    said: str
    rest_s: float  # from the fault to rest
    travel: float  # rad


def commands(row: FaultTrial, machine: Machine, bus: str, folder: Path, axis: str) -> tuple[list[str], list[str]]:
    """Return the arguments of `isocenter` that emulate the machine with the fault of a row, and that run its sweep, on a bus."""
    file, faults = folder / "machine.toml", folder / "faults.toml"
    file.write_text(machine.text)
    faults.write_text(faults_text(row.settings))
    plan, speed = standard_scan(machine, axis)
    column = machine.axis_index(axis)
    begin, end = (f"{math.degrees(plan.reference[k, column]):.6f}" for k in (0, -1))
    emulate = ["emulate", str(file), "-b", bus, "--pose", f"{axis}={begin}", "--faults", str(faults), "--truth", str(folder / TRUTH)]
    sweep = ["--axis", axis, "--from", begin, "--to", end, "--speed", f"{math.degrees(speed):.6f}", "--dwell", "0.25"]
    return [*emulate, "--json", "-"], ["run", "scan", "-m", str(file), "-b", bus, *sweep, "-o", str(folder / "run.csv")]


def over_processes(row: FaultTrial, machine: Machine, bus: str, folder: Path, *more: str, axis: str = "roll") -> OverProcesses:
    """Run one row of the table over a bus.

    Parameters
    ----------
    row : FaultTrial
    machine : Machine
    bus : str
    folder : Path
        For the files of this run.
    *more : str
        Options of both commands.
    axis : str
        That sweeps.
    """
    emulate, run = commands(row, machine, bus, folder, axis)
    isocenter, said = [sys.executable, "-m", "hil"], folder / "said.txt"
    emulator = subprocess.Popen([*isocenter, *emulate, *more], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert emulator.stdout is not None
        assert emulator.stdout.readline(), "the emulator did not start"
        with said.open("w") as errors:
            bench = subprocess.Popen(
                [*isocenter, *run, *more],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
        status = ended(bench.pid, bench.poll, said)
        bench.wait()
        time.sleep(WATCHED_S)
    finally:
        emulator.send_signal(signal.SIGINT)
        emulator.wait(60.0)
    return judged(said.read_text(), status, folder / TRUTH, machine, axis)


def ended(pid: int, poll: Callable[[], int | None], said: Path) -> int:
    """Return the exit status of a run in a session of its own; one that stays to serve a hold is killed, and has stopped."""
    give_up = time.monotonic() + RUN_AT_MOST_S
    while (status := poll()) is None:
        holds = HELD in said.read_text()
        if holds:
            time.sleep(WATCHED_S)
        if holds or time.monotonic() > give_up:
            os.killpg(pid, signal.SIGKILL)
            return int(holds)
        time.sleep(0.1)
    return status


def judged(said: str, status: int, truth: Path, machine: Machine, axis: str) -> OverProcesses:
    """Return what became of a run from what it said, its exit status, and the truth of its emulator."""
    began_at = FAST_SHARE * standard_scan(machine, axis)[1]
    head, *lines = truth.read_text().splitlines()
    names = [cell.split(" [")[0] for cell in head.split(",")]
    whole = [line for line in lines if line.count(",") == head.count(",")]
    values = np.array([[float(cell) for cell in line.split(",")] for line in whole])
    time_s, position = values[:, names.index("time")], values[:, names.index(f"joint_position_{axis}")]
    speed = np.gradient(position, time_s)
    said = " ".join(line for line in said.splitlines() if "machine time" not in line)
    fast = np.flatnonzero(np.abs(speed) > began_at)
    if not len(fast):
        return OverProcesses("never began", said, math.nan, math.nan)
    first, last = int(fast[0]), int(np.flatnonzero(np.abs(speed) > STILL_SPEED)[-1])
    travel = float(np.abs(np.diff(position[first : last + 1])).sum())
    if time_s[-1] - time_s[last] < REST_S:
        return OverProcesses("not at rest", said, math.nan, travel)
    noted = "sensors not to be believed" in said or "run.csv: " in said
    verdict = "noted" if noted else "stopped" if status else "unnoticed"
    return OverProcesses(verdict, said, float(time_s[last] - time_s[first]), travel)


def main() -> None:
    """Run every row, and keep each as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--bus", default=f"udp:{GROUP}")
    parser.add_argument("--results", type=Path, default=RESULTS / "faults_over_processes.json")
    options = parser.parse_args()
    machine = load_machine("carm")
    lockstep = {row["name"]: row for row in json.loads((RESULTS / "faults_carm.json").read_text(encoding="utf-8"))["rows"]}
    document = json.loads(options.results.read_text(encoding="utf-8")) if options.results.exists() else {}
    kept = {row["name"]: row for row in document.get("rows", []) if document.get("hash") == machine.hash}
    for (row,) in (trials(machine, "roll", [name]) for name in MOST_DANGEROUS):
        if kept.get(row.name, NOT_YET)["verdict"] != NOT_YET["verdict"]:
            continue
        for attempt in range(1, ATTEMPTS + 1):  # noqa: B007 - kept with the row
            with tempfile.TemporaryDirectory() as folder:
                outcome = over_processes(row, machine, options.bus, Path(folder))
            if outcome.verdict != "never began" and not THE_COMPUTERS.search(outcome.said):
                break
        beside = lockstep[row.name]
        kept[row.name] = {
            "name": row.name,
            "verdict": outcome.verdict,
            "rest_s": round(outcome.rest_s, 3) if math.isfinite(outcome.rest_s) else None,
            "travel": round(outcome.travel, 4) if math.isfinite(outcome.travel) else None,
            "lockstep": {key: beside[key] for key in ("verdict", "rest_s", "travel")},
            "attempts": attempt,
            "said": outcome.said[:220],
        }
        print(json.dumps(kept[row.name]), flush=True)
        rows = [kept[name] for name in MOST_DANGEROUS if name in kept]
        same = sum(row["verdict"] == row["lockstep"]["verdict"] for row in rows)
        document = {"machine": machine.name, "hash": machine.hash, "bus": options.bus.split(":")[0], "same": same, "rows": rows}
        options.results.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
