"""A re-tuned machine file is the user's own file: comments and order stay, and numbers have the digits that their interval supports."""

from __future__ import annotations

import numpy as np
import pytest

from hil.machine import Machine, load_machine, machine_from_text
from hil.machine.retuned_file import retuned_text
from virtual_bus.plant.parameters import plant_parameters

FACTOR = 1.0123456789


def tuned(machine: Machine, factors: dict[str, float], half_width: float | None = None) -> str:
    """The file with these numbers multiplied, each known within a share of itself."""
    parameters = plant_parameters(machine.plant)
    names = [f"{one.owner}.{one.quantity}" for one in parameters]
    assert set(factors) <= set(names), names
    values = np.array([one.value * factors.get(name, 1.0) for one, name in zip(parameters, names, strict=True)])
    if half_width is None:
        return retuned_text(machine, parameters, values)
    intervals = {name: (value * (1.0 - half_width), value * (1.0 + half_width)) for name, value in zip(names, values.tolist(), strict=True)}
    return retuned_text(machine, parameters, values, intervals)


def test_only_the_lines_of_re_tuned_numbers_change_and_comments_stay() -> None:
    machine = load_machine("carm")
    text = tuned(machine, {"detector_mount.stiffness": FACTOR, "sleeve.mass": FACTOR, "c_arc.center_of_mass_x": FACTOR}, 0.02)
    schema, header, *new = text.splitlines()
    assert schema.startswith("#:schema ")
    assert header == "# carm, its numbers re-tuned to recordings by `isocenter diagnose`"
    _, *old = machine.text.splitlines()
    changed = [(before, after) for before, after in zip(old, new, strict=True) if before != after]
    assert changed == [
        ("mass_kg = 60.0", "mass_kg = 60.741"),
        ("center_of_mass_m = [-0.18, 0.01, 0.28]", "center_of_mass_m = [-0.182222, 0.01, 0.28]"),
        ("stiffness_Nm_rad = 1.015e4", "stiffness_Nm_rad = 10275.3"),
    ]
    assert max(map(len, text.splitlines())) == max(map(len, machine.text.splitlines()))


@pytest.mark.parametrize(("half_width", "written"), [(0.5, "101.23"), (0.02, "101.235"), (2e-6, "101.2345679"), (0.0, "101.235")])
def test_digits_are_those_that_the_interval_supports(half_width: float, written: str) -> None:
    machine = machine_from_text(load_machine("emps").text.replace("mass_kg = 95.1089", "mass_kg = 100.0"))
    line = next(line for line in tuned(machine, {"carriage.mass": FACTOR}, half_width).splitlines() if line.startswith("mass_kg"))
    assert line.split("#")[0].strip() == f"mass_kg = {written}"
    assert line.endswith("# identified, all moving parts seen at the load")


def test_without_intervals_every_digit_is_kept() -> None:
    read = machine_from_text(tuned(load_machine("emps"), {"carriage.mass": FACTOR}))
    assert read.plant.tree.bodies[0].mass_kg == pytest.approx(95.1089 * FACTOR, rel=1e-12)


def test_a_drive_without_a_rotor_gets_one_among_its_own_keys() -> None:
    machine = load_machine("emps")
    parameters = plant_parameters(machine.plant)
    values = np.array([1.25 if one.quantity == "armature" else one.value for one in parameters])
    text = retuned_text(machine, parameters, values, {})
    drive = text.partition("[drives.carriage]")[2].partition("\n\n")[0]
    assert "rotor_mass_kg = 1.25" in drive.splitlines()
    assert machine_from_text(text).plant.tree.joints[0].armature == pytest.approx(1.25)


def test_moments_that_rounding_would_take_from_every_rigid_body_are_written_whole() -> None:
    machine = load_machine("turntable")
    thin = machine_from_text(machine.text.replace("[3.6, 3.6, 7.0,", "[3.3333333333, 3.6666666667, 7.0,"))  # at the triangle inequality
    text = tuned(thin, {f"table.inertia_{entry}": FACTOR for entry in ("xx", "yy", "zz")}, 0.5)
    moments = np.diag(machine_from_text(text).plant.tree.bodies[0].inertia_kg_m2)
    assert moments[0] + moments[1] == pytest.approx(moments[2], rel=1e-9)
