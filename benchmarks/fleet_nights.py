"""Four emulated C-arms through recordings, identification and diagnosis every night, by the fleet's own engine.

    python benchmarks/fleet_nights.py WORK [--nights 60] [--machines NAME ...] [--json OUT]

The machines hide what those of fleet_recorded.py hide: on `growing` roll's dry friction rises from night 20 on, on `stepping` propeller's
jumps on night 30, two are sound. A night is a multisine on a jog in two experiments, which are to be identified and explained, and a scan
to judge the diagnosis by. After each night `isocenter fleet run` does what is new, with a diagnosis of every night, and OUT takes what was
found. A night that is there is not recorded again, so the script goes on where it was stopped; several processes may each take a machine,
with a WORK of their own.

OUT has the tracks of friction and modes, the processor seconds of a machine's night, and how friction scatters about what was hidden: by
how much, beside what the diagnosis states and what the drawn fleets of fleet_change.py assume, how correlated dry and viscous friction
are, and what of the scatter is carried to the next night, which should be none.

A machine's night takes 13 s of a processor for recording and identification and more than 90 s for a diagnosis: at least seven hours of one
core for four machines and 60 nights, and 1.1 GB of memory.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import re
import resource
import shutil
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fleet_change import MEASURED
from fleet_recorded import AXES, FIRST_NIGHT, MACHINES, NIGHTS, NOMINAL, hidden

import hil
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Experiment, Jog, Multisine, Scan
from hil.machine import load_machine

RESULTS = Path(__file__).resolve().parent / "results" / "fleet_nights.json"
EXPERIMENTS: dict[str, Experiment] = {
    "shake": Multisine(period_s=4.0, periods=2, jog=Jog(math.radians(4.0), line=1)),
    "scan": Scan(axis="roll", start=-0.3, stop=0.3, pose={"propeller": 0.2}),
}
FLEET = """format = 1
[every]
file = "carm"
recordings = "recordings/{name}"
repeats = ["shake_*"]
held_out = ["scan_*"]
tasks = ["check", "identify", "diagnose"]
diagnose_when = "always"
[limits.diagnose]
time_s = 36000.0
"""
"""The limit of time is that of a computer that has other work, too."""

NUMBERS = "select machine, night, quantity, value, standard_deviation from results where value is not null and (task = 'identify' or "
NUMBERS += "quantity like '%friction%everyday') order by night, machine, quantity"
VERDICTS = (
    "select machine, night, verdict, message from results where task = 'diagnose' and quantity in ('verdict', 'failure') order by 2, 1"
)


class Number(NamedTuple):
    """A quantity of a machine on a night, with its stated deviation."""

    machine: str
    night: int
    quantity: str
    value: float
    deviation: float | None


def record(work: Path, machine: str, night: int) -> Path:
    """Record a machine's night, whole or not at all, and return its folder."""
    folder = work / "recordings" / machine / str(FIRST_NIGHT + datetime.timedelta(night))
    if folder.exists():
        return folder
    carm = load_machine("carm")
    really, seed = carm.with_effects(tuple(hidden(machine, night))), 10 * (1000 * MACHINES.index(machine) + night)
    draft = work / f"draft_{machine}"
    shutil.rmtree(draft, ignore_errors=True)
    draft.mkdir(parents=True)
    for place, (name, experiment) in enumerate(EXPERIMENTS.items()):
        for number, plan in enumerate(experiment.plans(carm)):
            with open_bench(carm, BenchOptions("lockstep:", seed=seed + 5 * place + number, emulated=really)) as bench:
                bench.run(plan, draft / f"{name}_{number}.mf4")
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft.rename(folder)
    return folder


def processor_s() -> float:
    """Return what this process and the ended ones of the fleet's tasks have taken [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def take(work: Path, machines: list[str], night: int) -> dict[str, float] | None:
    """Record and work on a night; return what a machine's took, None where all was done before."""
    began_s, wall_s = processor_s(), time.monotonic()
    for machine in machines:
        record(work, machine, night)
    recorded_s = processor_s() - began_s
    entries = "".join(f'[[machine]]\nname = "{name}"\n' for name in machines)
    (work / "fleet.toml").write_text(FLEET + entries, encoding="utf-8")
    run = hil.run_fleet(work / "fleet.toml", workers=0, say=print)
    if not run.done:
        return None
    count = len(machines)
    return {
        "night": night, "recording_s": round(recorded_s / count, 1), "work_s": round((processor_s() - began_s - recorded_s) / count, 1),
        "wall_s": round((time.monotonic() - wall_s) / count, 1),
    }  # fmt: skip


def numbers(store: Path) -> list[Number]:
    """Return what was found of friction and modes."""
    rows = hil.query_fleet(store, NUMBERS).rows
    return [Number(machine, (when.date() - FIRST_NIGHT).days, *rest) for machine, when, *rest in rows]


def tracks(found: list[Number]) -> dict[str, dict[str, list[list[float | None]]]]:
    """Return [night, value, stated deviation] of each machine's quantities, to five digits."""
    of_machine: dict[str, dict[str, list[list[float | None]]]] = {}
    for one in found:
        short = [None if value is None else float(f"{value:.5g}") for value in (one.value, one.deviation)]
        of_machine.setdefault(one.machine, {}).setdefault(one.quantity, []).append([one.night, *short])
    return of_machine


def compared(found: list[Number]) -> dict[str, dict[str, Any]]:
    """Return how friction scatters about what was hidden, each machine's mean error taken off, beside what the drawn fleets assume."""
    template = json.loads(MEASURED.read_text(encoding="utf-8"))
    drawn = {name[2]: place for place, name in enumerate(template["parameters"])}
    answer: dict[str, dict[str, Any]] = {}
    for axis in AXES:
        scatters = {}
        for law in NOMINAL:
            of = f"{axis} {law}"
            these = [one for one in found if one.quantity.startswith(of)]
            if not these:
                continue
            errors = {(one.machine, one.night): one.value - true(one, law, axis) for one in these}
            bias = {machine: np.mean([error for (name, _), error in errors.items() if name == machine]) for machine, _ in errors}
            scatter = scatters[law] = {key: float(error - bias[key[0]]) for key, error in errors.items()}
            answer[of] = {
                "machine_nights": len(these),
                "mean_error": {machine: float(error) for machine, error in bias.items()},
                "scatter": float(np.sqrt(np.mean(np.square(list(scatter.values()))))),
                "stated_deviation": float(np.nanmedian([math.nan if one.deviation is None else one.deviation for one in these])),
                "drawn_deviation": template["deviations"][drawn[f"{of} level"]],
                "carried_to_the_next_night": correlation([(x, scatter.get((m, n + 1))) for (m, n), x in scatter.items()]),
            }
        if len(scatters) == len(NOMINAL):
            dry, viscous = (scatters[law] for law in NOMINAL)
            places = [drawn[f"{axis} {law} level"] for law in NOMINAL]
            answer[f"{axis}, correlation of dry and viscous friction"] = {
                "scatter": correlation([(x, viscous.get(key)) for key, x in dry.items()]),
                "drawn": template["correlation"][places[0]][places[1]],
            }
    return answer


def compared_modes(found: list[Number]) -> dict[str, dict[str, Any]]:
    """Return how frequencies and dampings scatter about each machine's own mean, which is the same every night, beside what is drawn."""
    template = json.loads(MEASURED.read_text(encoding="utf-8"))
    answer = {}
    for named, deviation in zip(template["parameters"], template["deviations"], strict=True):
        if not (match := re.fullmatch(r"mode ([\d.]+) Hz (\w+)", named[2])):
            continue
        nominal_Hz, kind = float(match[1]), match[2]
        of_mode = {one.quantity: one.value for one in found if re.fullmatch(r"mode \d+ frequency", one.quantity)}
        if not of_mode:
            continue
        nearest = min(of_mode, key=lambda name: abs(of_mode[name] - nominal_Hz)).removesuffix("frequency")
        these = [one for one in found if one.quantity == nearest + kind]
        mean = {each.machine: np.mean([one.value for one in these if one.machine == each.machine]) for each in these}
        answer[named[2]] = {
            "machine_nights": len(these),
            "scatter": float(np.sqrt(np.mean([(one.value - mean[one.machine]) ** 2 for one in these]))),
            "stated_deviation": float(np.median([one.deviation for one in these if one.deviation is not None])),
            "drawn_deviation": deviation,
        }
    return answer


def true(one: Number, law: str, axis: str) -> float:
    """Return what a machine hid on a night."""
    [effect] = [each for each in hidden(one.machine, one.night) if (each.name, each.at) == (law, axis)]
    return effect.parameters[NOMINAL[law][0]]


def correlation(pairs: list[tuple[float, float | None]]) -> float | None:
    """Return the correlation of what is known on both sides; None of fewer than three."""
    known = np.array([pair for pair in pairs if pair[1] is not None], dtype=float)
    return float(np.corrcoef(known.T)[0, 1]) if len(known) >= 3 else None


def main() -> None:
    """Work on the nights in order."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path, help="folder of recordings and results")
    parser.add_argument("--nights", type=int, default=NIGHTS)
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=list(MACHINES))
    parser.add_argument("--json", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    work, kept = arguments.work, arguments.work / "costs.json"
    costs = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else []
    for night in range(arguments.nights):
        if (cost := take(work, arguments.machines, night)) is None:
            continue
        costs.append(cost)
        kept.write_text(json.dumps(costs), encoding="utf-8")
        print(cost, flush=True)
    found = numbers(work / "fleet-results")
    verdicts = hil.query_fleet(work / "fleet-results", VERDICTS).rows
    result = {
        "nights": arguments.nights, "machines": arguments.machines,
        "processor_s_of_a_machine_and_night": {
            kind: float(np.median([cost[f"{kind}_s"] for cost in costs])) for kind in ("recording", "work") if costs
        },
        "diagnoses": [[machine, (when.date() - FIRST_NIGHT).days, verdict] for machine, when, verdict in verdicts],
        "compared": compared(found) | compared_modes(found), "tracks": tracks(found),
    }  # fmt: skip
    arguments.json.write_text(json.dumps(result) + "\n", encoding="utf-8")
    print(json.dumps({name: figures for name, figures in result.items() if name not in ("tracks", "diagnoses")}, indent=1))


if __name__ == "__main__":
    main()
