"""What becomes of a moving axis when the bench's processes are killed, or stand still for a while, over two processes on UDP.

The emulated C-arm sweeps roll at 0.4 rad/s. Then the loop, the I/O's poller, the recorder or the supervisor are killed (SIGKILL), alone and
together; in some rows somebody else goes on sending the bench's heartbeat, which keeps the drives from stopping by themselves. In other
rows one of them, or all, are stopped (SIGSTOP) and go on after a time. The truth is the emulator's. Time and travel count from the kill to
rest; a run that goes on has none. No device has a fault: what the bench says must accuse none. Ended early, the script goes on where it
was. One command:

    python benchmarks/killed_together.py
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import can
import numpy as np

from drivers.udp_bus import UdpBus
from hil.machine import load_machine

GROUP = "239.74.163.201"
SPEED = 0.4
RESTING = 1e-3  # rad/s
WATCHED_S = 12.0
ATTEMPTS = 4
ROWS = (
    ("loop",),
    ("poller",),
    ("supervisor",),
    ("loop", "poller"),
    ("loop", "poller", "recorder"),
    ("loop", "poller", "recorder", "supervisor"),
    ("loop", "poller", "recorder", "foreign heartbeat"),
    ("loop", "supervisor", "foreign heartbeat"),
)
PROCESSES = ("loop", "poller", "recorder", "supervisor")
STOPPED_S = (0.2, 1.0, 5.0)
"""For which processes are stopped: what a computer may take for other work, up to what no watchdog lets pass."""
ACCUSES = re.compile(r"\(node \d+\): (no heartbeat|late heartbeats)|slips|frozen|second|somebody else|drifts|its drive measures|no packet")
"""Words that blame a device, or another sender, for a silence or a motion."""


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False).stdout
    return [int(word) for word in found.split()]


def roles(pid: int) -> dict[str, int]:
    """Return the bench's processes by what they do: the poller leaves the session, the recorder is a module of its own."""
    found = {"loop": pid}
    for child in children(pid):
        words = Path(f"/proc/{child}/cmdline").read_bytes().decode().replace("\0", " ")
        if "recorder" in words:
            found["recorder"] = child
        elif "spawn_main" in words:
            found["poller" if os.getsid(child) == child else "supervisor"] = child
    return found


def run(row: tuple[str, ...], folder: Path, stopped_s: float | None = None) -> dict[str, object]:
    """Kill these processes during a sweep, or stop them for a while, and return what the truth says."""
    bus, truth, never = f"udp:{GROUP}", folder / "truth.csv", folder / "never.toml"
    never.write_text('[[fault]]\nname = "imu_nan"\nat = "imu"\nwhen = "abs(speed_roll) > 100.0"\n')  # the truth goes on after the last SYNC
    emulator = subprocess.Popen(
        [sys.executable, "-m", "hil", "emulate", "carm", "--bus", bus, "--truth", str(truth), "--faults", str(never), "--json", "-"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        return under_way(row, folder, stopped_s, emulator, truth)
    finally:
        emulator.kill()
        emulator.wait()


def under_way(
    row: tuple[str, ...], folder: Path, stopped_s: float | None, emulator: subprocess.Popen[str], truth: Path
) -> dict[str, object]:
    """Start a sweep beside an emulated machine, kill or stop processes, and return what the truth says."""
    assert emulator.stdout is not None
    emulator.stdout.readline()
    bus = f"udp:{GROUP}"
    scan = ["scan", "-m", "carm", "--axis", "roll", "--from", "45", "--to", "-45", "--speed", f"{np.degrees(SPEED):.2f}"]
    with (folder / "said.txt").open("w") as errors:
        bench = subprocess.Popen(
            [sys.executable, "-m", "hil", "run", *scan, "--bus", bus, "-o", str(folder / "run.mf4")],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
        )
    line = UdpBus(GROUP)
    scaling = load_machine("carm").bus.scalings[1]  # type: ignore[union-attr]
    positions: list[tuple[float, int]] = []
    give_up = time.monotonic() + 120.0
    while time.monotonic() < give_up and bench.poll() is None:
        message = line.recv(0.1)
        if message is None or message.arbitration_id != 0x182:
            continue
        positions.append((time.monotonic(), int.from_bytes(message.data[2:6], "little", signed=True)))
        if len(positions) > 32:
            (before_s, before), (now_s, now) = positions[-32], positions[-1]
            if abs(now - before) * scaling.position_resolution / (now_s - before_s) > 0.95 * SPEED:
                break
    if bench.poll() is not None:  # a loaded computer: the run ended before it was to
        line.shutdown()
        raise RuntimeError((folder / "said.txt").read_text())
    processes = roles(bench.pid)
    hit = [processes[role] for role in row if role in processes]
    for process in hit:
        with contextlib.suppress(ProcessLookupError):  # the loop's children end with it
            os.kill(process, signal.SIGKILL if stopped_s is None else signal.SIGSTOP)
    killed_s = time.monotonic()
    stamp = os.stat(truth).st_size
    while time.monotonic() - killed_s < WATCHED_S + (stopped_s or 0.0):
        if stopped_s is not None and time.monotonic() - killed_s >= stopped_s:
            for process in hit:
                with contextlib.suppress(ProcessLookupError):  # the bench has replaced it meanwhile
                    os.kill(process, signal.SIGCONT)
            hit = []
        if "foreign heartbeat" in row:
            line.send(can.Message(arbitration_id=0x77F, is_extended_id=False, data=b"\x05"))
        line.recv(0.02)
    line.shutdown()
    goes_on = bench.poll() is None
    said = [line for line in (folder / "said.txt").read_text().splitlines() if line.startswith("isocenter: ")]
    for left in processes.values():
        with contextlib.suppress(ProcessLookupError):
            os.kill(left, signal.SIGKILL)
    bench.wait()
    emulator.send_signal(signal.SIGINT)
    emulator.communicate(timeout=60.0)
    last = said[-1] if said else ""
    goes_on = goes_on and not last
    rest = {} if goes_on else rest_of(truth, stamp)
    hides = stopped_s is not None and "loop" in row and "this program stood still" not in last  # what came of it is told as the cause
    return {**rest, "goes_on": goes_on, "accuses": len(ACCUSES.findall(last)) + hides, "said": last}


def rest_of(truth: Path, size: int) -> dict[str, float | bool]:
    """Return time and travel to rest of roll from where the truth file had this size."""
    with truth.open() as file:
        rows = list(csv.reader(file))
    head = rows[0]
    lengths = np.cumsum([sum(len(cell) for cell in row) + len(row) for row in rows])
    start = max(1, int(np.searchsorted(lengths, size)) - 1)
    values = np.array([[float(cell) for cell in row] for row in rows[start:]])
    time_s, roll = values[:, head.index("time [s]")], values[:, head.index("joint_position_roll [rad]")]
    speed = np.gradient(roll, time_s)
    moving = np.flatnonzero(np.abs(speed) > RESTING)
    last = int(moving[-1]) if len(moving) else 0
    return {
        "at_rest": bool(time_s[-1] - time_s[last] > 0.5),
        "rest_s": float(time_s[last] - time_s[0]),
        "travel_rad": float(np.abs(np.diff(roll[: last + 1])).sum()),
    }


def main() -> None:
    """Run every row, and keep each as soon as it is there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results" / "killed_together.json")
    results = parser.parse_args().results
    kept = json.loads(results.read_text(encoding="utf-8")) if results.exists() else {}
    rows = {**kept.get("rows", {})}
    wanted: list[tuple[str, tuple[str, ...], float | None]] = [(", ".join(row), row, None) for row in ROWS]
    for each in (*((role,) for role in PROCESSES), PROCESSES):
        wanted += [(f"{', '.join(each)}: stopped for {stopped_s:g} s", each, stopped_s) for stopped_s in STOPPED_S]
    for name, row, stopped_s in wanted:
        if name in rows:
            continue
        for left in reversed(range(ATTEMPTS)):
            try:
                with tempfile.TemporaryDirectory() as folder:
                    rows[name] = run(row, Path(folder), stopped_s)
                break
            except RuntimeError:
                if not left:
                    raise
        print(json.dumps({name: rows[name]}), flush=True)
        results.write_text(json.dumps({"speed_rad_s": SPEED, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
