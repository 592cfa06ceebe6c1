"""The fleet's detector beside the library `ruptures`, on the same drawn tracks: `python benchmarks/fleet_ruptures.py [--json OUT]`.

`ruptures` splits each track, what the median machine does taken off, in units of its scatter, by least squares with a penalty per split
(Killick, Fearnhead, Eckley 2012, JASA 107(500)); parts have five nights at least, as the fleet's detector needs five that agree. The
penalty is what white tracks of the same length gain by a split at the rate that the fleet's detector states. So it is as strict on noise
that is white, and knows nothing of machines that follow a season by factors of their own, of scatter that is carried from night to night,
and of bad nights. It looks back over all nights; the fleet's detector speaks night by night. `white` is where what the library supposes
holds: fleets of white tracks of one parameter, where the same machines should be found by both.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import ruptures
from fleet_change import FIRST_NIGHT, MACHINES, MEASURED, NIGHTS, YEAR, drawn, hide

from hil.fleet.change import FleetChange, Parameter, Tracks, fleet_change
from hil.fleet.change.threshold import SETTLING, STATED_PER_MACHINE_YEAR

RESULTS = Path(__file__).resolve().parent / "results" / "fleet_ruptures.json"
SHORTEST = 5  # nights of a part
SOUND_SEED, SOUND_FLEETS, FOUND_SEED = 7000, 3, 1
WHITE_TRACKS = 200_000
STEPPING, STEPS, DRAWS = 10, (1.0, 1.5, 2.0, 3.0), 5  # machines that step of 200, by how many deviations, fleets of each


def penalty(nights: int, parameters: int) -> float:
    """Return what a split of a white track gains, in its variance, once in as many years as the stated rate says, by drawing tracks."""
    random = np.random.default_rng([20260101, nights])
    splits = np.arange(SHORTEST, nights - SHORTEST + 1)
    gains = []
    for _ in range(0, WHITE_TRACKS, 10_000):
        sums = np.cumsum(random.standard_normal((10_000, nights)), axis=1)
        before, whole = sums[:, splits - 1], sums[:, -1:]
        gains.append((before**2 / splits + (whole - before) ** 2 / (nights - splits) - whole**2 / nights).max(axis=1))
    share = STATED_PER_MACHINE_YEAR / parameters * (nights - SETTLING) / YEAR
    return float(np.quantile(np.concatenate(gains), 1.0 - share))


def splits(tracks: Tracks, pen: float) -> dict[str, dict[str, Any]]:
    """Return by machine the parameter whose splits gain most, and the first of them."""
    own = tracks.values - np.nanmedian(tracks.values, axis=1, keepdims=True)
    own = own - np.nanmedian(own, axis=0)
    scale = np.nanmedian(np.abs(np.diff(own, axis=1)), axis=(0, 1)) / 0.6745 / np.sqrt(2.0)
    found: dict[str, dict[str, Any]] = {}
    for m, machine in enumerate(tracks.machines):
        for j, parameter in enumerate(tracks.parameters):
            known = np.flatnonzero(np.isfinite(own[m, :, j]))
            track = own[m, known, j] / scale[j]
            ends = ruptures.KernelCPD(kernel="linear", min_size=SHORTEST).fit(track[:, None]).predict(pen=pen)
            if len(ends) > 1:
                parts = np.split(track, ends[:-1])
                gain = float(np.sum((track - track.mean()) ** 2) - sum(np.sum((part - part.mean()) ** 2) for part in parts))
                if machine not in found or gain > found[machine]["gain"]:
                    found[machine] = {"gain": gain, "quantity": parameter.quantity, "since": int(known[ends[0]]), "splits": len(ends) - 1}
    return found


def ours(found: FleetChange) -> dict[str, dict[str, Any]]:
    """Return the same of the fleet's detector."""
    first = found.tracks.nights[0]
    return {each.machine: {"quantity": each.parameter.quantity, "since": int((each.since - first).astype(int))} for each in found.changes}


def scored(named: dict[str, dict[str, Any]], hidden: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of who was named, of 30 machines that change."""
    got = {machine: named[machine] for machine in hidden if machine in named}
    steps = [abs(got[machine]["since"] - hidden[machine]["begins"]) for machine in got if hidden[machine]["kind"] == "step"]
    return {
        "found": len(got), "false_machines": len(named) - len(got),
        "parameter_right": sum(got[machine]["quantity"] == hidden[machine]["quantity"] for machine in got),
        "map_right": 1.0 - (len(hidden) - len(got) + len(named) - len(got)) / MACHINES,
        "step_begins_within_nights_median": float(np.median(steps)) if steps else None,
        "step_begins_within_nights_most": max(steps, default=None),
    }  # fmt: skip


def white() -> dict[str, Any]:
    """Return what both find of steps on white tracks, by their size in standard deviations; the rest of the machines is sound."""
    pen = penalty(NIGHTS, 1)
    result: dict[str, Any] = {"penalty": pen}
    for place, size in enumerate(STEPS):
        found, false, alike = {"fleet": 0, "library": 0}, {"fleet": 0, "library": 0}, 0
        for draw in range(DRAWS):
            random = np.random.default_rng([20260101, 9000, place, draw])
            values = 10.0 * random.standard_normal((MACHINES, 1, 1)) + random.standard_normal((MACHINES, NIGHTS, 1))
            values[:STEPPING, NIGHTS // 2 :] += size
            names, nights = [f"m{machine:03d}" for machine in range(MACHINES)], FIRST_NIGHT + np.arange(NIGHTS)
            covariances, builds = np.ones((MACHINES, NIGHTS, 1, 1)), np.zeros((MACHINES, NIGHTS, 2), dtype=int)
            tracks = Tracks(names, nights, [Parameter("friction", "jog", "coulomb_friction level", "Nm")], values, covariances, builds)
            named = {"fleet": set(ours(fleet_change(tracks))), "library": set(splits(tracks, pen))}
            for who, machines in named.items():
                found[who] += len(machines & set(names[:STEPPING]))
                false[who] += len(machines - set(names[:STEPPING]))
            alike += MACHINES - len(named["fleet"] ^ named["library"])
        shares = {who: {"found_share": found[who] / (STEPPING * DRAWS), "false": false[who]} for who in found}
        result[f"{size:g}"] = {**shares, "machines_told_alike": alike / (MACHINES * DRAWS)}
    return result


def main() -> None:
    """Compare, and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    template = json.loads(MEASURED.read_text())
    parameters = len(template["parameters"])
    short, long = penalty(NIGHTS, parameters), penalty(YEAR, parameters)
    result: dict[str, Any] = {"ruptures": ruptures.version.version, "penalty": {str(NIGHTS): short, str(YEAR): long}}
    tracks = drawn(template, FOUND_SEED, NIGHTS)
    hidden = {tracks.machines[machine]: truth for machine, truth in hide(tracks, template, 0).items()}
    result["found"] = {
        "hidden": len(hidden),
        "fleet": scored(ours(fleet_change(tracks)), hidden),
        "library": scored(splits(tracks, short), hidden),
    }
    result["white"] = white()
    print(json.dumps(result, indent=1), flush=True)
    years = {"fleet": 0.0, "library": 0.0}
    alarms = {"fleet": 0, "library": 0}
    for seed in range(SOUND_SEED, SOUND_SEED + SOUND_FLEETS):
        tracks = drawn(template, seed, YEAR)
        found = fleet_change(tracks)
        years["fleet"] += found.watched_years
        years["library"] += MACHINES * (YEAR - SETTLING) / YEAR
        alarms["fleet"] += len(found.changes)
        alarms["library"] += len(splits(tracks, long))
    result["sound"] = {
        who: {"machine_years": years[who], "false_machines": alarms[who], "per_100_machine_years": 100.0 * alarms[who] / years[who]}
        for who in years
    }
    arguments.json.write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result["sound"], indent=1))


if __name__ == "__main__":
    main()
