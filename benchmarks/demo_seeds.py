"""The demo's detection limits, and what its answers are worth over seeds that were fixed beforehand.

python benchmarks/demo_seeds.py limits                       write hil/demo/limits.toml
python benchmarks/demo_seeds.py score [--jobs N]             run what is missing of the fifty seeds, and print the score
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import DriverError
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.demo.hidden import LIMITS, TIMES, Envelope, stronger
from hil.demo.recorded import HELD_OUT, TOUR, demo_machine, recorded
from hil.diagnosis.diagnose import audit_recordings
from hil.diagnosis.free_runs.runs import free_runs
from hil.diagnosis.model_choice.alternatives import detection_limits
from hil.diagnosis.model_choice.choose import choose_effects
from hil.diagnosis.model_choice.search import library
from hil.diagnosis.residuals.residuals import residuals_of
from hil.errors import BenchError
from hil.machine.effects_file import effects_text
from hil.recording import read_recording
from hil.terminal.progress import progress
from virtual_bus.errors import EmulatorError
from virtual_bus.settings import EffectSetting

SEEDS = range(1001, 1051)
"""Fixed before the first of them was run."""
RESULTS = Path(__file__).parent / "results" / "demo_seeds.json"


def write_limits() -> None:
    """Record the machine without anything hidden, and write every effect at its detection limit."""
    with tempfile.TemporaryDirectory() as folder, progress() as bars:
        machine = demo_machine(Path(folder))
        paths, _ = recorded(machine, Envelope(0, (), ()), Path(folder), bars)
        recordings = {path.stem: read_recording(path) for path in paths[:-1]}
        residuals = residuals_of(machine, recordings, freely=True)
        choice = choose_effects(residuals, free_runs(residuals, audit_recordings(machine, recordings, {})))
        if choice.best.settings:
            sys.exit(f"a machine that hides nothing: {', '.join(one.name for one in choice.best.settings)} is named")
        found = detection_limits(choice, library(choice.linear, choice.best, choice.of))
        shown = [limit.setting for limit in found if limit.setting is not None]
    with ProcessPoolExecutor() as workers:  # a load that the bench refuses to move is in no recording
        moves = list(workers.map(can_be_moved, shown))
    shown = [one for one, can_move in zip(shown, moves, strict=True) if can_move]
    print(f"not taken: {moves.count(False)} that the catalogue does not have, or the bench does not move, at {TIMES[1]:g} limits")
    header = "# Effects that the demo's recordings could show, at their detection limits. Written by benchmarks/demo_seeds.py limits.\n"
    LIMITS.write_text(header + effects_text(shown, machine), encoding="utf-8")
    print(f"{LIMITS}: {len(shown)} effects and places")


def can_be_moved(limit: EffectSetting) -> bool:
    """Return whether the bench brings a machine to the demo's poses that has an effect about as strong as the demo draws it at most."""
    drawn = (stronger(limit, times) for times in np.linspace(TIMES[1], TIMES[0], 7))
    strong = next((one for one in drawn if one is not None), None)
    if strong is None:
        return False
    with tempfile.TemporaryDirectory() as folder, suppress(BenchError, DriverError, EmulatorError):
        machine = demo_machine(Path(folder))
        for experiment in (TOUR, HELD_OUT):
            plan = experiment.plans(machine)[0]
            with open_bench(machine, BenchOptions("lockstep:", seed=0, emulated=machine.with_effects((strong,))), plan.start_pose) as bench:
                bench.run(plan, Path(folder) / "run.mf4")
        return True
    return False


def score(results: Path, jobs: int) -> None:
    """Run the demo by seeds that are not in the results yet, and print the score."""
    done = json.loads(results.read_text(encoding="utf-8"))["runs"] if results.exists() else {}
    with ThreadPoolExecutor(jobs) as threads:
        for seed, one in threads.map(told, [seed for seed in SEEDS if str(seed) not in done]):
            done[str(seed)] = one
            document = {"score": scored(done), "runs": dict(sorted(done.items()))}
            results.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
            print(
                f"{seed}: {one['worth']}: {_words(one, 'hidden')}; named {_words(one, 'findings') or 'nothing'}; {one['process_s']:.0f} s",
                flush=True,
            )
    for name, value in scored(done).items():
        print(f"{name}: {value}")


def scored(done: Mapping[str, Any]) -> dict[str, float]:
    """Return how many answers are worth what, and how long demos took."""
    told = Counter(one["worth"] for one in done.values())
    times = [one["process_s"] for one in done.values() if one["worth"] != "failed"]
    wrong = [one for one in done.values() if one["worth"] in ("wrong", "in part")]
    alone = [one for one in done.values() if len(one.get("hidden", ())) == 1]
    return {
        "seeds": len(done),
        **{worth: told[worth] for worth in ("right", "listed", "in part", "silent", "wrong", "failed")},
        "one hidden": len(alone),
        "right of these": sum(one["worth"] == "right" for one in alone),
        "wrong or in part, and explained": sum(one["verdict"] == "explained" for one in wrong),
        "median_s": statistics.median(times),
        "longest_s": max(times),
    }


def _words(one: Mapping[str, Any], key: str) -> str:
    return ", ".join(f"{each['effect']} at {each['at']}" for each in one.get(key, ()))


def told(seed: int) -> tuple[int, dict[str, Any]]:
    """Run the demo once, in a process of its own; return its seed and what is kept of its answer."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.monotonic()
        command = [sys.executable, "-m", "hil", "demo", "--seed", str(seed), "--out", folder, "--json", "-"]
        ran = subprocess.run(command, capture_output=True, text=True, check=False)
        seconds = {"process_s": round(time.monotonic() - began, 1)}
    if ran.returncode:
        return seed, {"worth": "failed", "said": ran.stderr.strip().splitlines()[-1:]} | seconds
    document = json.loads(ran.stdout)
    return seed, {key: document[key] for key in ("hidden", "worth", "verdict", "findings", "held_out", "seal")} | seconds


def main() -> None:
    """Run what is asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("limits", "score"))
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--jobs", type=int, default=1, help="demos at a time; times are those of a demo alone with one only")
    asked = parser.parse_args()
    if asked.what == "limits":
        write_limits()
    else:
        score(asked.results, asked.jobs)


if __name__ == "__main__":
    main()
