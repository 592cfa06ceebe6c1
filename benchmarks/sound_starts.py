"""Starts of sound machines drawn within the ranges of a file's effects: is any refused, or a sensor of it marked?

    python benchmarks/sound_starts.py --starts 300

Start by start in turn, the emulated machine is drawn from `carm-real`, or is `carm` with another seed of its sensors' noise; the bench
knows the file alone. Each is commissioned in lockstep (first move, homing, brake proofs) and stands for two seconds, at a drawn pose.
Results are kept as they come, in results/sound_starts.json; those that are there are not run again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.bench.signals import StopRequest
from hil.errors import in_one_line
from hil.experiments import Static
from hil.machine import load_machine
from hil.machine.drawn import drawn

RESULTS = Path(__file__).parent / "results" / "sound_starts.json"
MACHINES = ("carm-real", "carm-real", "carm")
OF = 200
"""Drawn machines of the Latin hypercube: two of three of 300 starts."""


def started(number: int) -> dict[str, Any]:
    """Return how one start went."""
    name = MACHINES[number % len(MACHINES)]
    machine, random = load_machine(name), np.random.default_rng([7, number])
    pose = {each.axis: float(random.uniform(0.7 * each.lower, 0.7 * each.upper)) for each in machine.limits}
    (plan,) = Static(2.0, pose).plans(machine)
    found: dict[str, Any] = {"machine": name, "number": number, "pose": [round(value, 3) for value in pose.values()]}
    request = StopRequest()
    emulated = drawn(machine, (2 * (number // 3) + number % 3) % OF, OF)
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            open_bench(machine, BenchOptions("lockstep:", seed=number, emulated=emulated), plan.start_pose, stop_request=request) as bench,
        ):
            bench.commission()
            judged = list(bench.judged) + list(bench.run(plan, Path(folder) / "still.mf4").judged)
    except Exception as error:
        if request.reason:
            sys.exit(f"ended: {in_one_line(error)[0]}")  # by a signal, which says nothing of the machine
        return {**found, "said": in_one_line(error)[0]}
    return {**found, "said": "; ".join(judged)}


def main() -> None:
    """Run what is missing, and say what was refused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=300)
    parser.add_argument("--from", type=int, default=0, dest="first")
    options = parser.parse_args()
    kept: list[dict[str, Any]] = json.loads(RESULTS.read_text(encoding="utf-8"))["starts"] if RESULTS.exists() else []
    done = {each["number"] for each in kept}
    for number in range(options.first, options.starts):
        if number in done:
            continue
        kept.append(started(number))
        lines = ",\n".join(json.dumps(each, ensure_ascii=False) for each in kept)
        refused = sum(bool(each["said"]) for each in kept)
        RESULTS.write_text(f'{{"count": {len(kept)}, "refused": {refused}, "starts": [\n{lines}\n]}}\n', encoding="utf-8")
        print("REFUSED " if kept[-1]["said"] else "", *kept[-1].values(), flush=True)
    sys.exit(1 if any(each["said"] for each in kept) else 0)


if __name__ == "__main__":
    main()
