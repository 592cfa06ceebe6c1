"""Numbers that a machine file allows to be wrong by more than 15 %, or to be something where it says zero."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.model_choice.choose import Choice, choose_effects
from hil.diagnosis.residuals.residuals import residuals_of
from hil.errors import MachineFileError
from hil.machine import Machine, load_machine
from hil.machine.load import machine_from_text
from hil.machine.retuned_file import retuned_text
from hil.recording import Channel, Recording, recording_metadata
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.parameters import plant_parameters
from virtual_bus.plant.rigid_bodies import rigid_bodies

RATE_Hz, STEPS, DURATION_s = 250.0, 16, 6.0
GRAVITY, MASS_kg, LENGTH_m, INERTIA_kg_m2, DAMPING, GAIN = 9.81, 6.0, 0.4, 0.25, 1.5, 2.0
OFFSET_m, HEAVIER = 0.03, 1.3
ARM = f"""
format = 1
name = "pendulum"
description = "An arm that hangs from a motor, ampere in, angle out"
gravity_m_s2 = [0.0, 0.0, -{GRAVITY}]

[timing]
sample_rate_Hz = {RATE_Hz}
substeps = 2

[[body]]
name = "arm"
parent = "world"
mass_kg = {MASS_kg}
center_of_mass_m = [0.0, 0.0, -{LENGTH_m}]
inertia_kg_m2 = [{INERTIA_kg_m2}, {INERTIA_kg_m2}, 0.01, 0, 0, 0]
[body.joint]
name = "shoulder"
type = "revolute"
axis = [0.0, 1.0, 0.0]
damping_Nm_s_rad = {DAMPING}

[drives.shoulder]
joint = "shoulder"
effort_unit = "A"
constant = {GAIN}
constant_unit = "Nm/A"
limit_A = 40.0

[sensors.position_shoulder]
type = "encoder"
joints = ["shoulder"]
kind = "absolute"
resolution_mrad = 0.005
"""


def swung(machine: Machine, *, mass_kg: float = MASS_kg, offset_m: float = 0.0) -> Recording:
    """The arm under a command that is the same whatever it does, by Euler's steps of its own equation (Lagrange's, in one angle).

    With its centre of mass at (d, 0, -L) in its frame, turned by q about y, it stands at a height of -d sin q - L cos q.
    """
    time = np.arange(round(DURATION_s * RATE_Hz)) / RATE_Hz
    command = (
        4.0 * np.sin(2.0 * np.pi * 0.45 * time) + 2.5 * np.sin(2.0 * np.pi * 1.3 * time + 1.0) + 1.0 * np.sin(2.0 * np.pi * 3.1 * time)
    )
    inertia = INERTIA_kg_m2 + mass_kg * (LENGTH_m**2 + offset_m**2)
    random = np.random.default_rng(11)
    angle, speed, position = float(np.arctan2(offset_m, LENGTH_m)), 0.0, np.zeros(len(time))
    step = 1.0 / RATE_Hz / STEPS
    applied = 0.0
    for k in range(len(time)):
        position[k] = angle
        for _ in range(STEPS):
            torque = GAIN * applied - DAMPING * speed + mass_kg * GRAVITY * (offset_m * np.cos(angle) - LENGTH_m * np.sin(angle))
            speed += torque / inertia * step
            angle += speed * step
        applied = command[k]
    channels = {
        "time": Channel("s", time),
        "command_shoulder": Channel("A", command),
        "position_shoulder": Channel("rad", position + 5e-6 * random.standard_normal(len(time))),
    }
    return Recording(channels, recording_metadata(machine, experiment={"start_pose": [position[0]]}))


def arm(tolerances: str = "") -> Machine:
    return machine_from_text(ARM + tolerances, label="pendulum.toml")


def linear(machine: Machine, **truth: float) -> tuple[Choice, dict[str, float]]:
    """The naming, and the numbers of the plant as it leaves them."""
    found = choose_effects(residuals_of(machine, {"run": swung(machine, **truth)}))
    names = [parameter.name for parameter in found.linear.plant.parameters]
    return found, dict(zip(names, found.linear.numbers.values(found.best.offset[: len(found.linear.numbers.indices)]), strict=True))


def test_an_offset_of_the_mass_that_the_file_calls_zero_is_a_number_where_it_has_a_tolerance() -> None:
    found, numbers = linear(arm("\n[tolerances]\narm = { center_of_mass_x_m = 0.05 }\n"), offset_m=OFFSET_m)
    assert numbers["arm.center_of_mass_x_m"] == pytest.approx(OFFSET_m, rel=0.05)
    assert not found.best.settings


def test_a_re_tuned_number_that_was_zero_is_written_in_the_file_s_own_unit() -> None:
    tolerances = "\n[tolerances]\narm = { center_of_mass_x_m = 0.05, inertia_xz_kg_m2 = 0.01, position_y_m = 0.1 }\n"
    for written in (f"center_of_mass_m = [0.0, 0.0, -{LENGTH_m}]", f"center_of_mass_mm = [0, 0, {-1000.0 * LENGTH_m}]"):
        machine = machine_from_text(ARM.replace(f"center_of_mass_m = [0.0, 0.0, -{LENGTH_m}]", written) + tolerances, label="pendulum.toml")
        parameters = plant_parameters(machine.plant)
        wanted = {"arm.center_of_mass_x_m": 0.0123, "arm.inertia_xz_kg_m2": -0.004, "arm.position_y_m": 0.05}
        values = np.array([wanted.get(parameter.name, parameter.value) for parameter in parameters])
        read = plant_parameters(machine_from_text(retuned_text(machine, parameters, values), label="re-tuned").plant)
        assert [parameter.value for parameter in read] == pytest.approx(values.tolist(), rel=1e-9, abs=1e-15)


def test_without_a_tolerance_a_zero_is_no_number() -> None:
    assert "arm.center_of_mass_x_m" not in [parameter.name for parameter in plant_parameters(arm().plant)]


@pytest.mark.nightly
def test_a_mass_goes_as_far_as_its_tolerance_and_what_is_more_is_physics() -> None:
    others = "center_of_mass_z_m = 1e-6, inertia_yy_kg_m2 = 1e-6 }\nshoulder = { constant_Nm_A = 1e-6 }"
    for tolerance, is_enough in ((3.0, True), (0.2, False)):
        found, numbers = linear(arm(f"\n[tolerances]\narm = {{ mass_kg = {tolerance}, {others}\n"), mass_kg=HEAVIER * MASS_kg)
        if is_enough:
            assert numbers["arm.mass_kg"] == pytest.approx(HEAVIER * MASS_kg, rel=0.02)
            assert not found.best.settings
        else:
            assert abs(numbers["arm.mass_kg"] - MASS_kg) <= tolerance * (1.0 + 1e-6)
            assert "payload" in {setting.name for setting in found.best.settings}


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("arms = { mass_kg = 1.0 }", "tolerances.arms: no such body, joint, drive or IMU; there is gravity, arm, shoulder"),
        ("arm = { mass = 1.0 }", "tolerances.arm.mass = 1.0: no such number; there is position_x_m"),
        ("arm = { mass_kg = 0.0 }", "tolerances.arm.mass_kg = 0.0: must be positive"),
    ],
)
def test_a_tolerance_of_nothing_is_refused_with_what_there_is(written: str, said: str) -> None:
    with pytest.raises(MachineFileError) as refused:
        arm(f"\n[tolerances]\n{written}\n")
    assert said in str(refused.value)


def test_inertias_that_no_body_has_become_those_of_one_and_what_turns_keeps_its_own() -> None:
    """A flat disc whose moment about its axis grows alone: the other two grow with it."""
    plant = compile_plant(load_machine("turntable").plant)
    bodies = rigid_bodies(plant.parameters)
    values = plant.nominal
    names = [f"{one.owner}.{one.quantity}" for one in plant.parameters]
    xx, yy, zz = (names.index(f"table.inertia_{axis}") for axis in ("xx", "yy", "zz"))
    values[zz] = 1.02 * (values[xx] + values[yy])
    found = bodies.rigid(values)
    assert found[zz] == pytest.approx(values[zz])
    assert found[xx] + found[yy] >= found[zz] * (1.0 - 1e-9)
    assert np.array_equal(bodies.rigid(plant.nominal), plant.nominal)
