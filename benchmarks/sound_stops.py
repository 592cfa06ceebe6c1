"""Stops of sound machines at instants drawn over scans, jogs and multisines: is anything accused that is sound?

    python benchmarks/sound_stops.py carm carm-real --stops 500

Each stop is a run in lockstep that hold-to-run ends at an instant of its own, or the end of the recorded motion. Results are kept as they
come, in results/sound_stops.json; those that are there are not run again. It ends with status 1 where a run was refused, a brake accused,
or an axis not brought to rest.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.signals import StopRequest
from hil.errors import ExperimentError, in_one_line
from hil.experiments import Jog, Multisine, Plan, Scan
from hil.machine import Machine, load_machine

RESULTS = Path(__file__).parent / "results" / "sound_stops.json"
DRAWN = "stopped at a drawn instant"
PERIOD_S = 5.0  # of a multisine, and of a jog
PROVEN = "the motors were stopped: "
"""Begins what is said of axes that are all at rest, each with its brake proven or closed."""


def drawn_plan(machine: Machine, random: np.random.Generator) -> tuple[str, Plan]:
    """Return a drawn motion in words, and its plan."""
    axis = str(random.choice(machine.axes))
    limit = machine.limits[machine.axis_index(axis)]
    kind = str(random.choice(["scan", "scan", "jog", "multisine"]))
    if kind == "scan":
        speed = float(random.uniform(0.1, 1.0) * limit.speed)
        begin, end = sorted(random.uniform(0.9 * limit.lower, 0.9 * limit.upper, 2), reverse=bool(random.integers(2)))
        (plan,) = Scan(axis, float(begin), float(end), speed, dwell_s=0.25).plans(machine)
        return f"scan of {axis} from {begin:+.2f} to {end:+.2f} at {speed:.2f}", plan
    pose = {each.axis: float(random.uniform(0.7 * each.lower, 0.7 * each.upper)) for each in machine.limits}
    jog = Jog(amplitude_rad=float(random.uniform(0.01, 0.04)), line=1) if kind == "jog" else None
    amplitude = (0.02 if kind == "jog" else float(random.uniform(0.05, 0.2))) * machine.plant.drives[machine.axis_index(axis)].limit
    made = Multisine(pose, (axis,), "single", amplitude_A=amplitude, period_s=PERIOD_S, periods=1, jog=jog, seed=int(random.integers(1000)))
    (plan, *_) = made.plans(machine)
    return f"{kind} of {axis}, excited by {amplitude:.2f}", plan


def stopped(machine: Machine, seed: int) -> dict[str, Any]:
    """Return how one drawn run was stopped."""
    random = np.random.default_rng([seed, zlib.crc32(machine.name.encode())])
    plan = None
    while plan is None:
        with contextlib.suppress(ExperimentError):  # one that the machine cannot make
            motion, plan = drawn_plan(machine, random)
    row = int(random.integers(0, plan.rows))
    request = StopRequest()
    drawn = {"machine": machine.name, "seed": seed, "motion": motion, "row": row}
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            open_bench(machine, BenchOptions("lockstep:", seed=seed), plan.start_pose, stop_request=request) as bench,
        ):
            exchange_of_link, passed = bench.loop.link.exchange, [-1]

            def exchange(command: np.ndarray) -> Any:
                begun = passed[0] >= 0 or bench.wiring.link.events.all()[-1].what == "run begins"
                passed[0] += begun
                if passed[0] == row:
                    request.ask(DRAWN)
                return exchange_of_link(command)

            bench.loop.link.exchange = exchange  # type: ignore[method-assign]
            bench.run(plan, Path(folder) / "run.mf4")
    except Exception as error:
        said = in_one_line(error)[0]
        return {**drawn, "said": said, "good": f"{DRAWN}; {PROVEN}" in said}
    return {**drawn, "said": "", "good": True}


def main() -> None:
    """Run what is missing, and say what was accused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machines", nargs="+")
    parser.add_argument("--stops", type=int, default=500, help="of each machine")
    arguments = parser.parse_args()
    kept: list[dict[str, Any]] = json.loads(RESULTS.read_text())["stops"] if RESULTS.exists() else []
    done = {(each["machine"], each["seed"]) for each in kept}
    for seed in range(arguments.stops):
        for machine in map(load_machine, arguments.machines):
            if (machine.name, seed) in done:
                continue
            kept.append(stopped(machine, seed))
            RESULTS.write_text(json.dumps({"stops": kept}, indent=1, ensure_ascii=False) + "\n")
            print(
                "" if kept[-1]["good"] else "ACCUSED ", *[kept[-1][key] for key in ("machine", "seed", "motion", "row", "said")], flush=True
            )
    bad = [each for each in kept if not each["good"]]
    print(f"{len(kept)} stops, {len(bad)} accuse something")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
