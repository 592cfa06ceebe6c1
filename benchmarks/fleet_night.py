"""A whole night of a fleet through `isocenter fleet run`: 200 C-arms with three recordings of 10 s each, on two workers.

    python benchmarks/fleet_night.py WORK [--json OUT] [--machines 200]

Two machines have dry friction that their file lacks: their checks differ, so they are diagnosed. The others have, in turn, sets of
recordings of other seeds. OUT has the time on the wall, what all processes took of the processors, and the most memory that was resident
in all of them together; shared pages count in each. A result that is there is not computed again, so WORK must be a new folder; recordings
are kept in it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
from fleet_engine import FLEET, MACHINES

import hil

SETS, CHANGED = 4, 2
"""Sets of recordings of sound machines, of other seeds; and machines that changed, of 200: over 60 nights 30 do, and a change is looked at
for a few nights."""

FRICTION_Nm = 4.0
LOOK_S = 0.25


def recordings(made: Path) -> None:
    """Make the sets of three recordings of 10 s; the last has the friction."""
    carm = hil.open_machine("carm")
    shaken = hil.Multisine(period_s=2.0, periods=4, settle_periods=1, jog=None)
    moved = hil.Scan(axis="roll", start=-0.3, stop=0.3)
    for number in range(SETS + 1):
        if (made / str(number)).exists():
            continue
        really = carm if number < SETS else carm.with_effect("coulomb_friction", "roll", Fc_Nm=FRICTION_Nm)
        draft = made / f"{number}.draft"
        draft.mkdir(parents=True, exist_ok=True)
        first, second = carm.run(shaken, bus="lockstep:", seed=number, emulated=really)
        scan = carm.run(moved, bus="lockstep:", seed=number, emulated=really)
        for name, recording in (("shake_1", first), ("shake_2", second), ("scan", scan.part(slice(0, first.rows)))):
            hil.write_recording(recording, draft / f"{name}.mf4")
        draft.rename(made / str(number))


def fleet_of(work: Path, machines: int) -> Path:
    """Give every machine its folder, and return the fleet's file."""
    recordings(work / "made")
    shutil.rmtree(work / "night", ignore_errors=True)
    names = [f"machine_{number:03d}" for number in range(machines)]
    for number, name in enumerate(names):
        which = SETS if number < CHANGED else number % SETS
        shutil.copytree(work / "made" / str(which), work / "night" / "recordings" / name / "2026-11-27")
    text = FLEET.replace('"identify"]', '"identify", "diagnose"]').replace("[every]", '[every]\nheld_out = ["scan"]')
    file = work / "night" / "fleet.toml"
    file.write_text(text + "".join(f'[[machine]]\nname = "{name}"\n' for name in names), encoding="utf-8")
    return file


def watched(command: list[str]) -> dict[str, float]:
    """Run a command; return its time on the wall, its processes' on the processors [s], and the most memory resident in all [GB]."""
    began_s, took_s, most_B = time.perf_counter(), {}, 0
    process = psutil.Popen(command, stdout=subprocess.DEVNULL)
    while process.poll() is None:
        resident_B = 0
        for one in (process, *process.children(recursive=True)):
            try:
                resident_B += one.memory_info().rss
                times = one.cpu_times()
            except psutil.Error:  # it has just ended
                continue
            took_s[one.pid, one.create_time()] = times.user + times.system
        most_B = max(most_B, resident_B)
        time.sleep(LOOK_S)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit status {process.returncode}")
    return {"wall_s": time.perf_counter() - began_s, "processor_s": sum(took_s.values()), "resident_GB": most_B / 1e9}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path, help="folder of recordings and results")
    parser.add_argument("--machines", type=int, default=MACHINES)
    parser.add_argument("--made", action="store_true", help="make the recordings, and do no more")
    parser.add_argument("--json", type=Path, default=Path(__file__).resolve().parent / "results" / "fleet_night.json")
    arguments = parser.parse_args()
    file = fleet_of(arguments.work.absolute(), arguments.machines)
    if arguments.made:
        return
    found: dict[str, Any] = {"machines": arguments.machines, "load_average": os.getloadavg()[0]}
    found |= watched([sys.executable, "-m", "hil", "fleet", "run", str(file), "--workers", "2"])
    store, taken = file.parent / "fleet-results", [path.stat().st_size for path in file.parent.rglob("*.mf4")]
    asked = (
        "select task, count(distinct file), count(distinct file) filter (where verdict in ('failed', 'unusable')) from results group by 1"
    )
    done = {task: {"results": count, "without_answer": without} for task, count, without in hil.query_fleet(store, asked).rows}
    found |= {
        "recordings": len(taken), "tasks": done, "processor_s_per_recording": found["processor_s"] / len(taken),
        "bytes_per_recording": sum(taken) / len(taken),
        "result_bytes_per_recording": sum(path.stat().st_size for path in store.rglob("*.parquet")) / len(taken),
    }  # fmt: skip
    arguments.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
