"""Whether `isocenter doctor` foretells the ten minutes after it: doctor and `run static` over UDP by turns.

    python benchmarks/doctor.py

Doctor and run share the computer with whatever else it does, which differs from one minute to the next. So each run is compared with
itself, too: the 99.9th percentiles of its halves (`halves`), of which no prediction can be closer to each other. Ten comparisons take two
hours; each is kept when it is done, and the next call goes on from there. Shorter runs are compared with their share of what is foretold.
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
from pathlib import Path
from typing import Any

import numpy as np

from hil.machine import load_machine
from hil.recording import read_recording

ISOCENTER = [sys.executable, "-m", "hil"]
BUS = "udp:239.74.163.96"
RESULTS = Path(__file__).parent / "results" / "doctor.json"
WITHIN = 1.5
TRIES = 20
PAUSE_S = 5.0


def foretold(machine: Path, seconds: float) -> dict[str, float]:
    """The prediction of the doctor, asked again while another bench runs on this computer."""
    for _ in range(TRIES):
        words = [*ISOCENTER, "doctor", "-m", str(machine), "--seconds", str(seconds), "--json", "-"]
        answer = json.loads(subprocess.run(words, capture_output=True, text=True, check=False).stdout)
        if answer["prediction"] is not None:
            return answer["prediction"]
        time.sleep(PAUSE_S)
    raise SystemExit(f"nothing was measured: {answer['findings'][-1]}")


def happened(machine: Path, folder: Path, seconds: float) -> tuple[np.ndarray, int]:
    """Whole ticks [s] of a run against an emulator in another process, and how many were missed."""
    recorded, answer = folder / "run.csv", folder / "answer.json"
    emulator = subprocess.Popen([*ISOCENTER, "emulate", str(machine), "--bus", BUS], stdout=subprocess.PIPE, text=True)
    try:
        assert emulator.stdout is not None and emulator.stdout.readline(), "the emulator did not start"
        words = ["run", "static", "-m", str(machine), "-b", BUS, "--seconds", str(seconds), "-o", str(recorded), "--json", str(answer)]
        subprocess.run([*ISOCENTER, *words], check=True, capture_output=True)
    finally:
        emulator.terminate()
        emulator.wait()
    recording = read_recording(recorded)
    missed = json.loads(answer.read_text())["recordings"][0]["timing"]["missed"]
    return recording["sync_lateness"] + recording["work_time"], missed


def compare(folder: Path, seconds: float, trial_s: float) -> dict[str, Any]:
    """One comparison."""
    machine = folder / "carm.toml"
    machine.write_text(re.sub(r"(?m)^(overrun|stale)_ticks = \d+", r"\1_ticks = 10000", load_machine("carm").text), encoding="utf-8")
    loads = [os.getloadavg()[0]]
    prediction = foretold(machine, trial_s)
    loads.append(os.getloadavg()[0])
    ticks, missed = happened(machine, folder, seconds)
    loads.append(os.getloadavg()[0])
    p999_s = float(np.percentile(ticks, 99.9))
    share = seconds / 600.0
    return {
        "foretold_p99.9_us": 1e6 * prediction["p999_s"],
        "happened_p99.9_us": 1e6 * p999_s,
        "ratio": prediction["p999_s"] / p999_s,
        "halves": float(np.divide(*(np.percentile(half, 99.9) for half in np.array_split(ticks, 2)))),
        "within_its_interval": prediction["p999_least_s"] <= p999_s <= prediction["p999_most_s"],
        "foretold_p50_us": 1e6 * prediction["p50_s"],
        "happened_p50_us": 1e6 * float(np.median(ticks)),
        "foretold_missed": share * prediction["expected_missed"],
        "foretold_missed_least": share * prediction["least_missed"],
        "foretold_missed_most": share * prediction["most_missed"],
        "happened_missed": missed,
        "load_average": loads,
    }


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Count what held."""
    within, halves = (sum(1.0 / WITHIN <= one[name] <= WITHIN for one in found) for name in ("ratio", "halves"))
    return {
        "runs": len(found),
        "p99.9_within_its_interval": sum(one["within_its_interval"] for one in found),
        "missed_within_its_interval": sum(
            one["foretold_missed_least"] <= one["happened_missed"] <= one["foretold_missed_most"] for one in found
        ),
        "within_a_factor_of": WITHIN,
        "how_many_within": within,
        "halves_within": halves,
        "ratio_quartiles": np.percentile([one["ratio"] for one in found], [0, 25, 50, 75, 100]).tolist(),
    }


def main() -> None:
    """Go on to so many comparisons, and write each when it is done."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=600.0, help="of each run")
    parser.add_argument("--trial", type=float, default=60.0, help="seconds of the doctor's trial")
    parser.add_argument("--json", type=Path, default=RESULTS, metavar="FILE", help="what is there already is kept")
    arguments = parser.parse_args()
    found = json.loads(arguments.json.read_text())["comparisons"] if arguments.json.exists() else []
    while len(found) < arguments.runs:
        with tempfile.TemporaryDirectory() as folder:
            found.append(compare(Path(folder), arguments.seconds, arguments.trial))
        arguments.json.write_text(json.dumps({"comparisons": found, **summary(found)}, indent=2) + "\n", encoding="utf-8")
        print(f"{len(found)} of {arguments.runs}: ratio {found[-1]['ratio']:.2f}, halves {found[-1]['halves']:.2f}", file=sys.stderr)


if __name__ == "__main__":
    main()
