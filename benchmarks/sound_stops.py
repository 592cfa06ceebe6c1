"""Stops of sound machines at instants drawn over scans, jogs and multisines: is anything accused that is sound?

    python benchmarks/sound_stops.py --stops 500

Stop by stop in turn, the machine is `carm`, `carm-real`, or one drawn within the ranges of `carm-real`'s effects. Of that, the bench knows
`carm-real` and the true pull of the cables, as commissioning shows it: more than dry friction holds is rightly told. Each stop is a run in
lockstep that is asked to end at a drawn row, and nothing may be said of it but that every axis is at rest, its brake proven, its voltage
off; the emulator's truth must bear that out. Results are kept as they come, in results/sound_stops.json; those that are there are not run
again. It ends with status 1 where anything else was said, or was not so.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import re
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
from hil.faults.budget import standing
from hil.faults.claims import Witness, contradictions
from hil.machine import Machine, load_machine
from hil.machine.drawn import drawn
from virtual_bus.faults.motion_log import MotionLog

RESULTS = Path(__file__).parent / "results" / "sound_stops.json"
MACHINES = ("carm", "carm-real", "drawn")
OF = 167
"""Drawn machines of the Latin hypercube: a third of 500 stops."""
ASKED = "asked to end at a drawn instant"
SAID = re.compile(
    rf"(row \d+: )?{ASKED}; the motors were stopped: propeller, roll at rest: brake proven, voltage off"
    r"(; \d+ rows are kept)?; (no encoder moved by more than [\w. -]+|standstill [\d.]+ s) after the stop began"
    r"( \([\w. ,-]+\))?(; \d+ rows are kept)?"
)
"""All that is said of sound axes, each at rest behind a proven brake."""
PERIOD_S = 5.0  # of a multisine, and of a jog


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


def with_cables_of(machine: Machine, other: Machine) -> Machine:
    """Return a machine with the cable springs of another."""
    effects = tuple(
        theirs if theirs.name == "cable_spring" else own for own, theirs in zip(machine.own_effects, other.own_effects, strict=True)
    )
    return dataclasses.replace(machine, plant=dataclasses.replace(machine.plant, effects=effects), own_effects=effects)


def stopped(name: str, seed: int) -> dict[str, Any]:
    """Return how one drawn run was stopped."""
    machine = load_machine("carm-real" if name == "drawn" else name)
    emulated = None
    if name == "drawn":
        emulated = drawn(machine, seed // len(MACHINES) % OF, OF)
        machine = with_cables_of(machine, emulated)
    random = np.random.default_rng([seed, zlib.crc32(name.encode())])
    plan = None
    while plan is None:
        with contextlib.suppress(ExperimentError):  # one that the machine cannot make
            motion, plan = drawn_plan(machine, random)
    row = int(random.integers(0, plan.rows))
    request, log, said, said_row, since_stop_s = StopRequest(), MotionLog(machine.axes), "", 0, float("nan")
    options = BenchOptions("lockstep:", seed=seed, emulated=emulated, motion=log)
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            open_bench(machine, options, plan.start_pose, stop_request=request) as bench,
        ):
            exchange_of_link, passed = bench.loop.link.exchange, [-1]

            def exchange(command: np.ndarray) -> Any:
                begun = passed[0] >= 0 or bench.wiring.link.events.all()[-1].what == "run begins"
                passed[0] += begun
                if passed[0] == row:
                    request.ask(ASKED)
                return exchange_of_link(command)

            bench.loop.link.exchange = exchange  # type: ignore[method-assign]
            try:
                bench.run(plan, Path(folder) / "run.mf4")
            finally:
                said_row, since_stop_s = len(log) - 1, bench.wiring.link.since_stop_s
    except Exception as error:
        said = in_one_line(error)[0]
    if request.reason not in ("", ASKED):
        sys.exit(f"ended: {said}")  # by a signal, which says nothing of the machine
    assert machine.bus is not None
    counts = [scaling.position_resolution for scaling in machine.bus.scalings]
    kept = re.search(r"(\d+) rows are kept", said)
    witness = Witness(
        log, said_row, [standing(machine, each) for each in machine.axes], counts, (), int(kept[1]) if kept else 0, since_stop_s
    )
    false = contradictions(said, witness)
    good = bool(SAID.fullmatch(said)) and not false
    result = {"machine": name, "seed": seed, "motion": motion, "row": row, "good": good}
    return result if good else {**result, "said": said, "contradicted": false}


def main() -> None:
    """Run what is missing, and say what was accused."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stops", type=int, default=500)
    stops = parser.parse_args().stops
    kept: list[dict[str, Any]] = json.loads(RESULTS.read_text(encoding="utf-8"))["stops"] if RESULTS.exists() else []
    done = {(each["machine"], each["seed"]) for each in kept}
    for seed in range(stops):
        name = MACHINES[seed % len(MACHINES)]
        if (name, seed) in done:
            continue
        kept.append(stopped(name, seed))
        lines = ",\n".join(json.dumps(each, ensure_ascii=False) for each in kept)
        RESULTS.write_text(f'{{"stops": [\n{lines}\n]}}\n', encoding="utf-8")
        print("" if kept[-1]["good"] else "ACCUSED ", *kept[-1].values(), flush=True)
    bad = [each for each in kept if not each["good"]]
    print(f"{len(kept)} stops, {len(bad)} accuse something")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
