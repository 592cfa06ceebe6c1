"""Whether a fleet's changes are found, and how often a sound machine is named: `python benchmarks/fleet_change.py STEP WORK [--json OUT]`.

Steps, each going on where it was stopped:
  measured   STORE of fleet_recorded.py: the covariances of a night's results, into benchmarks/results/fleet_change_measured.json
  sound      2000 machine-years in which nothing changes: eleven fleets of 200 machines over a year, with seasons that each machine follows
             by a factor of its own, a software update that shifts all, scatter that is carried from night to night, bad nights, gaps
  found      one fleet of 200 machines over 60 nights: 20 grow, 10 step
  short      forty such fleets, with thirty machines that change in each: machines that are named and did not; into OUT
  score      the rest of it into OUT

What is drawn was fixed before the first score; the constants below say it all.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from fleet_recorded import CHANGED, GROWTH_FROM, STEP_ON, GROWTH_Nm_per_night, STEP_Nm
from on_engine import add_scheduler, answers
from scipy.stats import chi2

from hil.fleet.change import FleetChange, Parameter, Tracks, fleet_change, fleet_sentence, read_tracks
from hil.fleet.change.sentences import sentences
from hil.fleet.change.threshold import SETTLING, STATED_PER_MACHINE_YEAR

HERE = Path(__file__).resolve().parent / "results"
MEASURED, RESULTS = HERE / "fleet_change_measured.json", HERE / "fleet_change.json"
MACHINES, YEAR, FLEETS, NIGHTS = 200, 365, 11, 60
GROWING, STEPPING = 20, 10
FIRST_NIGHT = np.datetime64("2026-01-01")

FIRST_SOUND = 3000
"""Seed of the first sound fleet. Those of 1000 to 2009 were looked at while the method was made, and are scored no more."""

FIRST_SHORT, SHORT_FLEETS = 6000, 40

BUILT = 0.10
"""Standard deviation between machines, relative to a parameter's value: how far those of one make differ."""

OWN_NIGHT = {"friction": 0.01, "frequency": 0.0005, "damping": 0.02, "other": 0.005}
"""Standard deviation between nights of one machine beyond the measured covariance, relative; half its variance is carried over nights."""

DRY = "coulomb_friction"
CARRIED = 0.6  # correlation of that half from night to night
SEASON = {"friction": 0.06, "frequency": 0.001, "damping": 0.03, "other": 0.0}
"""Half swing over a year, relative: friction of greased bearings falls by some tenths over a room's seasons."""

FOLLOWS = 0.4  # standard deviation of a machine's factor of the season, about 1
UPDATE, UPDATE_DIFFERS = {"friction": -0.02, "frequency": 0.0, "damping": 0.02, "other": 0.0}, 0.3
"""What a software update shifts on every machine, relative, and how much machines differ in it."""

BAD_NIGHT, BAD_AGAIN, BAD_SIZE = 0.02, 0.3, (5.0, 20.0)
"""Share of bad nights, how often the next is bad as well, and by how many standard deviations each parameter is then off, either way."""

GAP = 0.03  # share of nights without results
COVARIANCE_VARIES = 0.3  # standard deviation of the logarithm of a night's covariance
GROWTH = {"friction": 0.25, "frequency": -0.02, "damping": 0.30}
STEP = {"friction": 0.12, "frequency": -0.01, "damping": 0.20}
"""Relative; a growth has reached it on the last night. Dry friction from 6.1 to 8.4 Nm would be 0.38."""

SHOWN = 3.0
"""Standard deviations of a night's result that a step must be of, for a change to be hidden there: a C-arm's frictions, frequencies and
dampings are; a turntable's viscous friction is not, which cannot be told from the damping that its file states."""

GROWS_FROM, STEPS_ON, SIZE_VARIES = (15, 30), (20, 45), 0.2


def kind_of(quantity: str) -> str:
    """Return which sort of parameter a quantity is."""
    return next((kind for kind in ("friction", "frequency", "damping") if kind in quantity), "other")


def measured(store: Path) -> dict[str, Any]:
    """Return values, deviations and correlations of a night's results that have them: medians over all nights and machines."""
    tracks = with_deviations(read_tracks(store))
    known = np.isfinite(tracks.values)
    covariances = np.where(known[..., None] & known[..., None, :], tracks.covariances, np.nan)
    typical = np.nanmedian(covariances, axis=(0, 1))
    typical = np.where(np.isfinite(typical), typical, 0.0)
    deviations = np.sqrt(np.diag(typical))
    correlation = typical / np.outer(deviations, deviations)
    values, vectors = np.linalg.eigh(correlation)
    correlation = vectors * np.maximum(values, 1e-6) @ vectors.T
    return {
        "parameters": [list(parameter) for parameter in tracks.parameters],
        "values": np.nanmedian(tracks.values, axis=(0, 1)).tolist(),
        "deviations": deviations.tolist(),
        "correlation": np.round(correlation, 6).tolist(),
        "machine_nights": int(known.any(axis=2).sum()),
    }


def with_deviations(tracks: Tracks) -> Tracks:
    """Return the parameters that state a deviation, of the tasks of every night: a diagnosis is now and then."""
    nightly = np.isfinite(tracks.values).mean(axis=(0, 1)) > 0.5
    own = [j for j in range(len(tracks.parameters)) if nightly[j] and np.any(tracks.covariances[:, :, j, j] > 0.0)]
    parameters = [tracks.parameters[j] for j in own]
    covariances = tracks.covariances[:, :, own][..., own]
    return Tracks(tracks.machines, tracks.nights, parameters, tracks.values[..., own], covariances, tracks.builds)


def drawn(template: dict[str, Any], seed: int, nights: int) -> Tracks:
    """Draw a fleet in which nothing changes; see the constants."""
    random = np.random.default_rng([20260101, seed])
    parameters = [Parameter(*each) for each in template["parameters"]]
    kinds = [kind_of(parameter.quantity) for parameter in parameters]
    value = np.abs(template["values"])
    count = len(parameters)
    shape = (MACHINES, nights, count)

    def relative(table: dict[str, float]) -> np.ndarray:
        return np.asarray(np.array([table[kind] for kind in kinds]) * value)

    deviations = np.array(template["deviations"])
    covariance = np.array(template["correlation"]) * np.outer(deviations, deviations)
    varies = np.exp(COVARIANCE_VARIES * random.standard_normal(shape[:2]))
    root = np.linalg.cholesky(covariance + 1e-9 * np.diag(np.diag(covariance)))
    noise = random.standard_normal(shape) @ root.T * np.sqrt(varies)[..., None]
    own = random.standard_normal(shape)
    carried = np.empty(shape)
    carried[:, 0] = random.standard_normal((MACHINES, count))
    for night in range(1, nights):
        carried[:, night] = CARRIED * carried[:, night - 1] + np.sqrt(1.0 - CARRIED**2) * random.standard_normal((MACHINES, count))
    scatter = relative(OWN_NIGHT) * (own + carried) / np.sqrt(2.0)
    phase = random.uniform(0.0, 1.0)
    season = np.sin(2.0 * np.pi * (np.arange(nights) / 365.25 + phase)) - np.sin(2.0 * np.pi * phase)
    factor = 1.0 + FOLLOWS * random.standard_normal((MACHINES, 1, count))
    update = int(random.integers(nights // 4, 3 * nights // 4))
    shifted = (np.arange(nights) >= update)[None, :, None] * (1.0 + UPDATE_DIFFERS * random.standard_normal((MACHINES, 1, count)))
    level = value * (1.0 + BUILT * random.standard_normal((MACHINES, 1, count)))
    values = level + relative(SEASON) * factor * season[None, :, None] + relative(UPDATE) * shifted + scatter + noise
    bad = random.random(shape[:2]) < BAD_NIGHT
    bad[:, 1:] |= bad[:, :-1] & (random.random((MACHINES, nights - 1)) < BAD_AGAIN)
    spread = np.sqrt(deviations**2 + relative(OWN_NIGHT) ** 2)
    values += bad[..., None] * spread * random.uniform(*BAD_SIZE, shape) * random.choice([-1.0, 1.0], shape)
    values[random.random(shape[:2]) < GAP] = np.nan
    builds = np.zeros((*shape[:2], 2), dtype=int)
    builds[:, update:, 0] = 1
    builds[~np.isfinite(values).any(axis=2)] = -1
    named = [f"m{number:03d}" for number in range(MACHINES)]
    covariances = covariance * varies[..., None, None]
    return Tracks(named, FIRST_NIGHT + np.arange(nights), parameters, values, covariances, builds)


def hide(tracks: Tracks, template: dict[str, Any], taken: int, seed: int = 777) -> dict[int, dict[str, Any]]:
    """Hide growths and steps on machines, `taken` of each being recorded ones, and return what was hidden."""
    random = np.random.default_rng([20260101, seed])
    value = np.abs(template["values"])
    steps = [STEP.get(kind_of(parameter.quantity), 0.0) for parameter in tracks.parameters]
    able = np.flatnonzero(np.abs(steps) * value > SHOWN * np.array(template["deviations"])).tolist()
    machines = random.permutation(np.arange(4, MACHINES))[: GROWING + STEPPING - 2 * taken]
    hidden = {}
    night = np.arange(len(tracks.nights))
    for number, machine in enumerate(machines):
        grows = number < GROWING - taken
        j = int(random.choice(able))
        begins = int(random.integers(*(GROWS_FROM if grows else STEPS_ON)))
        size = (
            (GROWTH if grows else STEP)[kind_of(tracks.parameters[j].quantity)] * value[j] * (1.0 + SIZE_VARIES * random.standard_normal())
        )
        course = np.maximum(night - begins + 1, 0) / (night[-1] - begins + 1) if grows else night >= begins
        tracks.values[machine, :, j] += size * course
        hidden[int(machine)] = {
            "kind": "growth" if grows else "step",
            "quantity": tracks.parameters[j].quantity,
            "begins": begins,
            "size": size,
        }
    return hidden


def put_recorded(tracks: Tracks, store: Path) -> dict[int, dict[str, Any]]:
    """Put the recorded machines in place of the first four, and return what they hide."""
    recorded = with_deviations(read_tracks(store))
    places = [list(tracks.parameters).index(parameter) for parameter in recorded.parameters]
    nights = min(len(recorded.nights), len(tracks.nights))
    for number, machine in enumerate(recorded.machines):
        tracks.machines[number] = machine  # type: ignore[index]
        tracks.values[number] = np.nan
        tracks.values[number, :nights, places] = recorded.values[number, :nights].T
        for night in range(nights):
            tracks.covariances[number, night][np.ix_(places, places)] = recorded.covariances[number, night]
    known = np.isfinite(tracks.values[: len(recorded.machines)]).any(axis=2)
    tracks.builds[: len(recorded.machines)] = np.where(known, 0, -1)[..., None]
    dry = {axis: parameter.quantity for parameter in recorded.parameters for axis, law in [parameter.quantity.split()[:2]] if law == DRY}
    growing, stepping = (dry.get(axis) or next(iter(dry.values())) for axis in CHANGED.values())
    hides = {
        "growing": {"kind": "growth", "quantity": growing, "begins": GROWTH_FROM, "size": GROWTH_Nm_per_night * (nights - GROWTH_FROM)},
        "stepping": {"kind": "step", "quantity": stepping, "begins": STEP_ON, "size": STEP_Nm},
    }
    return {number: hides[machine] for number, machine in enumerate(recorded.machines) if machine in hides}


def sound(seed: int, work: str) -> None:
    """Watch a fleet in which nothing changes for a year; into a file."""
    started = time.process_time()
    found = fleet_change(drawn(json.loads(MEASURED.read_text()), FIRST_SOUND + seed, YEAR))
    keep(Path(work) / f"sound_{seed}.json", found, time.process_time() - started)


def short(seed: int, work: str) -> None:
    """Watch a fleet over `NIGHTS` nights in which thirty machines change; into a file."""
    started, template = time.process_time(), json.loads(MEASURED.read_text())
    tracks = drawn(template, seed, NIGHTS)
    hidden = {tracks.machines[machine] for machine in hide(tracks, template, 0, seed)}
    found = fleet_change(tracks)
    named = {each.machine for each in found.changes}
    path = Path(work) / f"short_{seed}.json"
    keep(path, found, time.process_time() - started, hidden=len(hidden), right=len(named & hidden), false=sorted(named - hidden))


def each_missing(step: Callable[[int, str], None], seeds: Iterable[int], work: Path, scheduler: str | None) -> None:
    """Watch the fleets that have no file yet."""
    missing = [seed for seed in seeds if not (work / f"{step.__name__}_{seed}.json").exists()]
    answers(step, [{"seed": seed, "work": str(work.absolute())} for seed in missing], scheduler)


def short_figures(work: Path) -> dict[str, Any]:
    """Return the figures of all fleets over `NIGHTS` nights."""
    fleets = [json.loads((work / f"short_{seed}.json").read_text()) for seed in range(FIRST_SHORT, FIRST_SHORT + SHORT_FLEETS)]
    years, false = sum(fleet["machine_years"] for fleet in fleets), sum(len(fleet["false"]) for fleet in fleets)
    wrong = sum(fleet["hidden"] - fleet["right"] for fleet in fleets)
    return {
        "fleets": len(fleets), "hidden": sum(fleet["hidden"] for fleet in fleets), "found": sum(fleet["right"] for fleet in fleets),
        "machine_years": round(years, 1), "false_machines": false, "per_100_machine_years": round(100.0 * false / years, 3),
        "upper_95": round(100.0 * float(chi2.ppf(0.95, 2 * false + 2)) / 2.0 / years, 3),
        "map_right": round(1.0 - (wrong + false) / MACHINES / len(fleets), 4),
    }  # fmt: skip


def keep(path: Path, found: FleetChange, seconds: float, **more: Any) -> None:
    """Write what was found."""
    alarms = [
        {
            "machine": each.machine, "quantity": each.parameter.quantity, "kind": each.kind, "sigma": round(each.sigma, 2),
            "alarm": str(each.alarm), "since": str(each.since),
        }
        for each in found.changes
    ]  # fmt: skip
    path.write_text(
        json.dumps({"alarms": alarms, "machine_years": found.watched_years, "threshold": found.threshold, "processor_s": seconds, **more})
    )
    print(path.name, len(alarms), "alarms in", round(found.watched_years, 1), "machine-years", round(seconds, 1), "s", flush=True)


def find(template: dict[str, Any], path: Path, store: Path | None = None) -> None:
    """Watch a fleet in which thirty machines change; with a store, the recorded machines are four of it. Into a file."""
    started = time.process_time()
    tracks = drawn(template, 1, NIGHTS)
    hidden = hide(tracks, template, int(store is not None))
    if store is not None:
        hidden |= put_recorded(tracks, store)
    found = fleet_change(tracks)
    recorded_nights = int(np.isfinite(tracks.values[0]).any(axis=1).sum()) if store is not None else 0
    named = {each.machine: each for each in found.changes}
    cases = []
    for machine, truth in sorted(hidden.items()):
        change = named.get(tracks.machines[machine])
        delay = None if change is None else int((change.alarm - FIRST_NIGHT).astype(int)) - truth["begins"]
        cases.append({"machine": tracks.machines[machine], **truth, "found": change is not None, "delay_nights": delay,
                      "named": None if change is None else change.parameter.quantity,
                      "named_kind": None if change is None else change.kind})  # fmt: skip
    false = sorted(set(named) - {tracks.machines[machine] for machine in hidden})
    said = {"sentences": sentences(found), "answer": fleet_sentence(found)}
    keep(path, found, time.process_time() - started, cases=cases, false=false, recorded_nights=recorded_nights, **said)


def delays(cases: list[dict[str, Any]], kind: str) -> dict[str, float]:
    """Return the least, median and greatest delay of the changes of a kind [nights]."""
    nights = [case["delay_nights"] for case in cases if case["kind"] == kind]
    return dict(zip(("least", "median", "most"), np.percentile(nights, (0, 50, 100)).tolist(), strict=True)) if nights else {}


def sound_figures(work: Path) -> dict[str, Any]:
    """Return the figures of the years in which nothing changes."""
    fleets = [json.loads(path.read_text()) for path in sorted(work.glob("sound_*.json"))]
    years, alarms = sum(fleet["machine_years"] for fleet in fleets), sum(len(fleet["alarms"]) for fleet in fleets)
    return {
        "machine_years": round(years, 1), "false_alarms": alarms, "per_100_machine_years": round(100.0 * alarms / years, 3),
        "upper_95": round(100.0 * float(chi2.ppf(0.95, 2 * alarms + 2)) / 2.0 / years, 3), "stated": 100.0 * STATED_PER_MACHINE_YEAR,
        "quantities": Counter(alarm["quantity"] for fleet in fleets for alarm in fleet["alarms"]),
        "processor_s_per_fleet_year": round(float(np.mean([fleet["processor_s"] for fleet in fleets])), 1),
    }  # fmt: skip


def found_figures(path: Path) -> dict[str, Any]:
    """Return the figures of one fleet in which thirty machines change."""
    found = json.loads(path.read_text())
    cases = found["cases"]
    got = [case for case in cases if case["found"]]
    early = [case for case in got if case["delay_nights"] < 0]
    return {
        "hidden": len(cases), "found": len(got), "before_it_began": len(early), "false_machines": len(found["false"]),
        "named_although_sound": found["false"], "map_right": round(1.0 - (len(cases) - len(got) + len(found["false"])) / MACHINES, 4),
        "parameter_right": sum(case["named"] == case["quantity"] for case in got),
        "kind_right": sum(case["named_kind"] == case["kind"] for case in got),
        "delay_nights": {kind: delays(got, kind) for kind in ("step", "growth")},
        "threshold": round(found["threshold"], 3), "nights_before_anything_is_said": SETTLING, "recorded_nights": found["recorded_nights"],
        "answer": found["answer"], "sentences": found["sentences"][:6], "cases": cases,
    }  # fmt: skip


def score(work: Path) -> dict[str, Any]:
    """Return the figures of what is there."""
    result = {"found": found_figures(work / "found.json")} if (work / "found.json").exists() else {}
    if any(work.glob("sound_*.json")):
        result["sound"] = sound_figures(work)
    return result


def main() -> None:
    """Run a step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("measured", "sound", "found", "short", "score"))
    parser.add_argument("work", type=Path, help="folder that keeps what was done; for `measured` the store")
    parser.add_argument("--json", type=Path, default=RESULTS)
    add_scheduler(parser)
    arguments = parser.parse_args()
    if arguments.step == "measured":
        MEASURED.write_text(json.dumps(measured(arguments.work)) + "\n")
        return
    arguments.work.mkdir(parents=True, exist_ok=True)
    if arguments.step == "score":
        before = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
        result = before | score(arguments.work)
        arguments.json.write_text(json.dumps(result, indent=1) + "\n")
        print(json.dumps({part: {k: v for k, v in figures.items() if k not in ("cases",)} for part, figures in result.items()}, indent=1))
        return
    if arguments.step == "short":
        each_missing(short, range(FIRST_SHORT, FIRST_SHORT + SHORT_FLEETS), arguments.work, arguments.scheduler)
        before = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
        arguments.json.write_text(json.dumps(before | {"short": short_figures(arguments.work)}, indent=1) + "\n")
    elif arguments.step == "sound":
        each_missing(sound, range(FLEETS), arguments.work, arguments.scheduler)
    else:
        find(json.loads(MEASURED.read_text()), arguments.work / "found.json")


if __name__ == "__main__":
    main()
