"""Four emulated turntables through recordings, friction and diagnosis, night by night, by the fleet's own engine.

    python benchmarks/fleet_nights.py WORK [--nights 60] [--scheduler local] [--json OUT]

Every machine hides its own Coulomb and viscous friction, as those of fleet_recorded.py do: on `growing` dry friction rises from night 20
on, on `stepping` it jumps on night 30, two are sound. A night is three recordings of 10 s: a multisine on a jog, twice, and a scan.
`isocenter fleet run` checks each, fits friction to all, and diagnoses the night on which `isocenter fleet change` first names a machine;
every tenth night is diagnosed in any case, at the end. What is there is not done again, so the script goes on where it was stopped.

OUT has what was found of these machines alone, and as four of a fleet of 200 whose others are drawn by the covariances that were measured
on them; 20 of the 200 grow and 10 step, in dry friction, since of viscous friction a night shows little. And how friction scatters about
what was hidden: by how much, beside what the fit states, how correlated dry and viscous friction are, and what of the scatter is carried
to the next night, which should be none.

A machine's night takes 3 s of a processor, and 6 s more where it is diagnosed: a C-arm's takes 16 s and 44 s more, which 240 times is too
much for a computer with two processors.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fleet_change import find, found_figures, measured
from fleet_recorded import FIRST_NIGHT, MACHINES, NIGHTS, hidden
from on_engine import LOCAL, add_scheduler, each

import hil
from hil.bench.open import open_bench
from hil.bench.options import BenchOptions
from hil.experiments import Experiment, Jog, Multisine, Scan
from hil.fleet.change import fleet_change, read_tracks
from hil.fleet.change.sentences import sentences
from hil.machine import load_machine

RESULTS = Path(__file__).resolve().parent / "results" / "fleet_nights.json"
AT_ONCE, EVERY = 15, 10
"""Nights that are recorded before they are worked on, and of which one is diagnosed in any case."""

MACHINE, AXIS = "turntable", "turn"
NOMINAL = {"coulomb_friction": ("Fc", {AXIS: 6.1}), "viscous_friction": ("Fv", {AXIS: 3.0})}
CHANGED = {"growing": AXIS, "stepping": AXIS}
EXPERIMENTS: dict[str, Experiment] = {
    "shake": Multisine(period_s=2.0, periods=4, settle_periods=1, jog=Jog(math.radians(3.5), line=1)),
    "again": Multisine(period_s=2.0, periods=4, settle_periods=1, jog=Jog(math.radians(3.5), line=1)),
    "scan": Scan(axis=AXIS, start=-0.75, stop=0.75, sweeps=2),
}
FLEET = """format = 1
[every]
file = "turntable"
recordings = "recordings/{name}{of}"
repeats = ["shake_*", "again_*", "scan_*"]
tasks = TASKS
diagnose_when = "WHEN"
[limits.friction]
time_s = 36000.0
[limits.diagnose]
time_s = 36000.0
"""
"""The limits of time are those of a computer that has other work, too."""

WATCHED, DIAGNOSED = ('["check", "friction", "diagnose"]', "changed"), ('["diagnose"]', "always")
NUMBERS = "select machine, night, quantity, value, standard_deviation from results where value is not null and task = 'friction' "
NUMBERS += "order by night, machine, quantity"
FOUND = "select machine, night, quantity, verdict, message, value, standard_deviation from results where task = 'diagnose' and "
FOUND += "quantity <> 'unexplained share' order by night, machine"


class Number(NamedTuple):
    """A quantity of a machine on a night, with its stated deviation."""

    machine: str
    night: int
    quantity: str
    value: float
    deviation: float | None


def folder_of(work: str, machine: str, night: int) -> Path:
    """Return the folder of a machine's night."""
    return Path(work) / "recordings" / machine / str(FIRST_NIGHT + datetime.timedelta(night))


def record(work: str, machine: str, night: int) -> None:
    """Record a machine's night, whole or not at all."""
    table, folder = load_machine(MACHINE), folder_of(work, machine, night)
    really, seed = table.with_effects(tuple(hidden(machine, night, NOMINAL, CHANGED))), 10 * (1000 * MACHINES.index(machine) + night)
    draft = Path(work) / f"draft_{machine}_{night}"
    shutil.rmtree(draft, ignore_errors=True)
    draft.mkdir(parents=True)
    for place, (name, experiment) in enumerate(EXPERIMENTS.items()):
        for number, plan in enumerate(experiment.plans(table)):
            with open_bench(table, BenchOptions("lockstep:", seed=seed + 5 * place + number, emulated=really)) as bench:
                bench.run(plan, draft / f"{name}_{number}.mf4")
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft.rename(folder)


def run(work: Path, name: str, tasks: tuple[str, str], scheduler: str | None, nights: str = "") -> None:
    """Do what is new of the machines' recordings."""
    entries = "".join(f'[[machine]]\nname = "{machine}"\n' for machine in MACHINES)
    (work / name).write_text(FLEET.replace("TASKS", tasks[0]).replace("WHEN", tasks[1]).replace("{of}", nights) + entries, encoding="utf-8")
    where = {"workers": 0} if scheduler is None else {} if scheduler == LOCAL else {"scheduler": scheduler}
    hil.run_fleet(work / name, say=print, **where)


def watch(work: Path, nights: int, scheduler: str | None) -> None:
    """Record some nights, work on them, and so on."""
    for first in range(0, nights, AT_ONCE):
        these = [(night, machine) for night in range(first, min(first + AT_ONCE, nights)) for machine in MACHINES]
        missing = [each for each in these if not folder_of(str(work), each[1], each[0]).exists()]
        for _ in each(record, [{"work": str(work), "machine": machine, "night": night} for night, machine in missing], scheduler):
            pass
        run(work, "fleet.toml", WATCHED, scheduler)
        print(datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"), "nights", len(these) // len(MACHINES) + first, flush=True)


def numbers(store: Path) -> list[Number]:
    """Return what was found of friction."""
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
    """Return how friction scatters about what was hidden, each machine's mean error taken off."""
    answer: dict[str, dict[str, Any]] = {}
    scatters = {}
    for law, (parameter, _) in NOMINAL.items():
        these = [one for one in found if one.quantity == f"{AXIS} {law} {parameter}"]
        errors = {(one.machine, one.night): one.value - true(one, law) for one in these}
        bias = {machine: np.mean([error for (name, _), error in errors.items() if name == machine]) for machine, _ in errors}
        scatter = scatters[law] = {key: float(error - bias[key[0]]) for key, error in errors.items()}
        answer[law] = {
            "machine_nights": len(these),
            "mean_error": {machine: float(error) for machine, error in bias.items()},
            "scatter": float(np.sqrt(np.mean(np.square(list(scatter.values()))))),
            "stated_deviation": float(np.nanmedian([math.nan if one.deviation is None else one.deviation for one in these])),
            "carried_to_the_next_night": correlation([(x, scatter.get((m, n + 1))) for (m, n), x in scatter.items()]),
        }
    dry, viscous = (scatters[law] for law in NOMINAL)
    return answer | {"dry and viscous friction": {"correlation": correlation([(x, viscous.get(key)) for key, x in dry.items()])}}


def true(one: Number, law: str) -> float:
    """Return what a machine hid on a night."""
    [effect] = [each for each in hidden(one.machine, one.night, NOMINAL, CHANGED) if each.name == law]
    return effect.parameters[NOMINAL[law][0]]


def correlation(pairs: list[tuple[float, float | None]]) -> float | None:
    """Return the correlation of what is known on both sides; None of fewer than three."""
    known = np.array([pair for pair in pairs if pair[1] is not None], dtype=float)
    return float(np.corrcoef(known.T)[0, 1]) if len(known) >= 3 else None


def scored(store: Path) -> dict[str, Any]:
    """Return what was found of the nights that are there, of these machines alone and as four of a fleet of 200."""
    found, change = numbers(store), fleet_change(read_tracks(store))
    find(measured(store), store / "of_200.json", store)
    diagnosed: dict[tuple[str, int], dict[str, Any]] = {}
    for machine, when, quantity, verdict, message, value, deviation in hil.query_fleet(store, FOUND).rows:
        one = diagnosed.setdefault((machine, (when.date() - FIRST_NIGHT).days), {})
        one.update({"verdict": verdict, "said": message} if value is None else {quantity: [value, deviation]})
    return {
        "machine_nights": len({(one.machine, one.night) for one in found}),
        "changes": [
            {
                "machine": each.machine, "quantity": each.parameter.quantity, "kind": each.kind, "sigma": round(each.sigma, 2),
                "alarm_on_night": int((each.alarm - np.datetime64(FIRST_NIGHT)).astype(int)),
            }
            for each in change.changes
        ],
        "sentences": sentences(change), "of_200": found_figures(store / "of_200.json"),
        "diagnoses": [{"machine": machine, "night": night, **one} for (machine, night), one in diagnosed.items()],
        "compared": compared(found), "tracks": tracks(found),
    }  # fmt: skip


def main() -> None:
    """Work on the nights in order."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path, help="folder of recordings and results")
    parser.add_argument("--nights", type=int, default=NIGHTS)
    parser.add_argument("--score", action="store_true", help="score what is there, and do no more")
    parser.add_argument("--json", type=Path, default=RESULTS)
    add_scheduler(parser)
    arguments = parser.parse_args()
    work = arguments.work.absolute()
    work.mkdir(parents=True, exist_ok=True)
    if not arguments.score:
        watch(work, arguments.nights, arguments.scheduler)
        for night in range(0, arguments.nights, EVERY):
            run(work, "diagnosed.toml", DIAGNOSED, arguments.scheduler, f"/{FIRST_NIGHT + datetime.timedelta(night)}/*.mf4")
    result = scored(work / "fleet-results")
    arguments.json.write_text(json.dumps(result) + "\n", encoding="utf-8")
    print(json.dumps({name: figures for name, figures in result.items() if name != "tracks"}, indent=1))


if __name__ == "__main__":
    main()
