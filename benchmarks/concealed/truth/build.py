"""One case: its strengths set by the detection limit, its recordings written, its truth worked out."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from concealed.truth.apart import oracle
from concealed.truth.draw import Case, Hidden
from concealed.truth.experiments import plan
from concealed.truth.oracle import NOTHING, NoiseUnits, left_over
from concealed.truth.plant import CORNER, IMU_CHANNELS, Drive, Machine
from concealed.truth.workshop import Chosen, Recorded, Workshop
from concealed.truth.writing import write_recording

DETECTION_LIMIT = 5.0
"""Standard deviations: found among forty candidates with nine chances in ten while one null in twenty alarms (3.3 + 1.3, rounded up)."""

SEARCH_STEPS = 4


def make_case(case: Case, machine: Machine, folder: Path, truth_path: Path) -> None:
    """Write the case's recordings and machine file to `folder` and its truth to `truth_path`."""
    shop = Workshop(case, machine)
    chosen = hidden_in(shop)
    setup = shop.setup(chosen)
    repeats = [shop.recorded(setup, shop.training, repeat) for repeat in range(case.repeats)]
    held_out = shop.recorded(setup, shop.held_out, case.repeats)
    truth = _describe(case, machine, chosen) | oracle(shop, chosen, setup, repeats, held_out)
    _write(shop, repeats, held_out, folder)
    truth_path.parent.mkdir(parents=True, exist_ok=True)
    truth_path.write_text(json.dumps(truth, indent=1), encoding="utf-8")


# ---- strengths --------------------------------------------------------------------------------------


def hidden_in(shop: Workshop) -> tuple[Chosen, ...]:
    """What a case hides, as strong as it is.

    Strengths come from the detection limit under the case's own experiment; a case with too little excitation takes it from a rich one.
    """
    rich, case = shop.training, shop.case
    if case.condition == "little":
        rich = plan(shop.machine, replace(case.training, kind="mixed"))
    if case.condition == "uncovered":
        rich = shop.held_out
    return _strengths(shop, rich)


def _strengths(shop: Workshop, drive: Drive) -> tuple[Chosen, ...]:
    """Each effect's strength, found alone: as many detection limits as the case says."""
    if not shop.case.hidden:
        return ()
    nothing = shop.setup(())
    base = shop.matrix(nothing, drive)
    assert base is not None, f"case {shop.case.number}: the plant without effects runs away"
    units = NoiseUnits(shop.noise([shop.recorded(nothing, drive, repeat) for repeat in range(100, 103)], base))
    # without the IMU's low passes, beside which a lag of it would have no limit: derivatives have no bounds
    nominal = [units(signal) for key, signal in shop.by_numbers(drive).items() if not key.startswith(CORNER)]
    return tuple(Chosen(hidden, _strength(shop, hidden, drive, units, nominal)) for hidden in shop.case.hidden)


def _strength(shop: Workshop, hidden: Hidden, drive: Drive, units: NoiseUnits, nominal: list[np.ndarray]) -> float:
    kind = hidden.kind
    largest = kind.largest(shop.machine, hidden.place)
    strength = min(kind.typical(shop.machine, hidden.place), largest)
    if kind.fixed:
        return largest
    if kind.tuned:  # a refit of the machine file's numbers takes it up by definition: there is no limit to count in
        return min(0.5 * hidden.times_limit * strength, largest)
    wanted = hidden.times_limit * DETECTION_LIMIT * np.sqrt(units.repeats / shop.case.repeats)
    (base, step_s), safe = shop.without_effects(drive), largest
    if kind.least:
        hardly = shop.matrix(shop.setup((Chosen(hidden, kind.least),)), drive, step_s)
        assert hardly is not None, f"case {shop.case.number}: the plant runs away"
        nominal = [*nominal, units(hardly - base)]
    for _ in range(SEARCH_STEPS):
        answer = shop.matrix(shop.setup((Chosen(hidden, strength),)), drive, step_s)
        if answer is None:
            safe = 0.5 * strength
            strength = safe
            continue
        found = left_over(units(answer - base), nominal)
        if found < NOTHING:  # nothing yet: a gap, a stop or a limit that is not reached
            strength = min(4.0 * strength, safe)
            continue
        strength = min(strength * float(np.clip(wanted / found, 0.02, 30.0)), safe)
    while shop.matrix(shop.setup((Chosen(hidden, strength),)), drive) is None:
        strength *= 0.5
    return max(strength, hidden.shape.get("least", 0.0))


# ---- what is written --------------------------------------------------------------------------------


def _names_of(machine: Machine, place: str) -> list[str]:
    """How a finding may say where this is: an axis is also its joint's body, its encoder, and the body on the spring behind it."""
    if place not in machine.axes:
        return [place, *(IMU_CHANNELS if place == "imu" else ())]
    spring = machine.spring_behind(place)
    names = [place, machine.joint_of[place], machine.body_of[machine.joint_of[place]], f"position_{place}"]
    return names + ([spring, machine.body_of[spring]] if spring else [])


def _describe(case: Case, machine: Machine, chosen: tuple[Chosen, ...]) -> dict[str, object]:
    """The truth in words and numbers."""
    effects = []
    for each in chosen:
        kind = each.hidden.kind
        effects.append({
            "kind": kind.name, "at": each.hidden.place, "accepted_at": _names_of(machine, each.hidden.place),
            "accepted": list(kind.accepted), "tuned": kind.tuned, "sensor": kind.sensor,
            "strength": each.strength, "shape": each.hidden.shape, "times_limit": each.hidden.times_limit,
            "compare": kind.compare(each.hidden.shape, each.strength),
        })  # fmt: skip
    return {
        "number": case.number, "stratum": case.stratum, "condition": case.condition, "machine": case.machine, "colour": case.colour,
        "disturbance": case.disturbance, "noise": case.noise, "repeats": case.repeats, "training": case.training.kind,
        "factors": case.factors, "effects": effects,
    }  # fmt: skip


def _write(shop: Workshop, repeats: list[Recorded], held_out: Recorded, folder: Path) -> None:
    """Recordings and the nominal machine file: all that the tool sees."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(shop.machine.path, folder / "machine.toml")
    names = [*(f"run_{repeat + 1}.csv" for repeat in range(len(repeats))), "held_out.csv"]
    for name, recorded in zip(names, [*repeats, held_out], strict=True):
        drive = recorded.drive
        columns = {"time": np.arange(len(drive.reference)) / shop.machine.rate_Hz}
        for i, axis in enumerate(shop.machine.axes):
            if shop.machine.closed:
                columns[f"reference_{axis}"], columns[f"excitation_{axis}"] = drive.reference[:, i], drive.excitation[:, i]
            columns[f"command_{axis}"] = recorded.answer.command[:, i]
        columns |= {channel: recorded.channels[channel] for channel in shop.case.channels}
        experiment = {"kind": "run", "start_pose": drive.start.tolist()}
        write_recording(folder / name, shop.under(drive), columns, experiment, recorded.answer.controller_states)
