"""What a machine file means once it is read."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np
import pytest

from hil.machine import Machine, list_shipped, load_machine, machine_from_text
from hil.machine.summary import machine_document, machine_lines
from hil.machine.units import UNITS

ONE_AXIS = """
format = 1
name = "slide"
[timing]
sample_rate_kHz = 1.0
substeps = 2
[[body]]
name = "base"
parent = "world"
mass_kg = 0.0
orientation_deg = [0.0, 0.0, 90.0]
[[body]]
name = "cart"
parent = "base"
mass_g = 2500.0
[body.joint]
name = "travel"
type = "prismatic"
axis = [1.0, 0.0, 0.0]
stiffness_N_mm = 3.0
damping_N_s_m = 4.0
rest_position_mm = 5.0
[drives.x]
joint = "travel"
effort_unit = "A"
constant = 70.0
constant_unit = "mNm/A"
ratio = 100.0
rotor_inertia_kg_cm2 = 0.5
rated_current_mA = 2500.0
limit_A = 4.0
target_resolution_permille = 1.0
[sensors.position_x]
type = "encoder"
joints = ["travel"]
kind = "incremental"
resolution_um = 2.0
"""


@pytest.fixture(scope="module")
def slide() -> Machine:
    return machine_from_text(ONE_AXIS)


def test_both_shipped_machines_are_listed() -> None:
    others = {"coupled_electric_drives", "emps", "laas_anti_cogging", "silverbox", "turntable"}
    assert set(list_shipped()) == {"carm", "carm-csp", "carm-csv", "carm-real", *others}


def test_the_c_arm_has_the_contracts_axes_rate_and_units() -> None:
    carm = load_machine("carm")
    assert carm.axes == ("propeller", "roll")
    assert carm.sample_rate_Hz == 256.0
    assert carm.plant.sample_period_s == 1.0 / 256.0
    assert [(units.position, units.effort) for units in carm.units] == [("rad", "A")] * 2
    assert -carm.limits[0].lower == carm.limits[0].upper >= math.radians(120.0)
    assert -carm.limits[1].lower == carm.limits[1].upper >= math.radians(90.0)
    assert [joint.name for joint in carm.plant.tree.joints if joint.name in carm.axes] == ["propeller", "roll"]


def test_what_a_count_and_a_permille_are_worth() -> None:
    carm = load_machine("carm")
    scaling = carm.bus.scalings[1]
    assert scaling.position_resolution == pytest.approx(math.tau / (4096 * 500))
    assert scaling.link_resolution == pytest.approx(math.tau / 2**23)
    assert scaling.rated_current_mA == 5000
    assert scaling.rated_torque_mNm == 475  # 5 A x 0.095 Nm/A
    assert carm.plant.drives[1].resolution == pytest.approx(0.005)


def test_pdo_names_become_objects_of_cia_402_and_406() -> None:
    nodes = {node.name: node for node in load_machine("carm").bus.nodes}
    assert nodes["roll_drive"].tpdos[0].entries == ((0x6041, 0, 16), (0x6064, 0, 32), (0x6078, 0, 16))
    assert nodes["roll_drive"].rpdos[0].entries == ((0x6040, 0, 16), (0x6071, 0, 16))
    assert nodes["roll_encoder"].tpdos[0].entries == ((0x6004, 0, 32),)


def test_a_pdo_entry_may_be_written_in_numbers() -> None:
    text = load_machine("carm").text.replace('"position_actual_value"', '"0x6064:00:32"', 1)
    assert machine_from_text(text).bus.nodes[0].tpdos[0].entries[1] == (0x6064, 0, 32)


def test_the_hash_is_sha256_of_the_text_and_the_text_is_the_file() -> None:
    carm = load_machine("carm")
    first, _, rest = carm.path.read_text().partition("\n")
    assert first.startswith("#:schema ")  # for editors: no part of the machine
    assert carm.hash == machine_from_text(rest).hash == hashlib.sha256(rest.encode()).hexdigest()
    assert machine_from_text("#:schema elsewhere.json\r\n" + rest).hash == carm.hash
    assert machine_from_text("# the arm\n" + rest).hash != carm.hash
    assert machine_from_text(carm.text).hash == carm.hash


def test_the_benchmark_axis_has_the_benchmarks_constants_and_a_cascaded_loop() -> None:
    emps = load_machine("emps")
    assert emps.bus is None
    assert emps.sample_rate_Hz == 1000.0
    body, drive, controller = emps.plant.tree.bodies[0], emps.plant.drives[0], emps.controllers[0]
    assert (body.mass_kg, body.joint.damping, drive.constant * drive.ratio) == (95.1089, 203.5034, 35.15065)
    # vir = kv (kp (qg - qm) - dqm/dt): at standstill both sections weigh a position alike, a ramp costs kv volts per m/s
    kp, kv = 160.18, 243.45
    reference, position = controller.reference_sections[0, :3], controller.position_sections[0, :3]
    assert reference.sum() == pytest.approx(kv * kp)
    assert position.sum() == pytest.approx(kv * kp)
    ramp = np.array([0.0, -1e-3, -2e-3])  # a position that moves at 1 m/s, now and one and two samples ago
    assert position @ ramp - kv * kp * 0.0 == pytest.approx(kv * (1.0 - 0.0), rel=1e-6)


def test_units_are_taken_from_the_keys(slide: Machine) -> None:
    cart, drive, encoder = slide.plant.tree.bodies[1], slide.plant.drives[0], slide.plant.encoders[0]
    assert slide.sample_rate_Hz == 1000.0
    assert cart.mass_kg == pytest.approx(2.5)
    assert cart.joint.stiffness == pytest.approx(3000.0)
    assert cart.joint.rest_position == pytest.approx(0.005)
    assert drive.constant == pytest.approx(0.070)
    assert drive.rated == pytest.approx(2.5)
    assert drive.resolution == pytest.approx(0.0025)
    assert encoder.resolution == pytest.approx(2e-6)


def test_the_rotors_inertia_is_seen_through_the_ratio_squared(slide: Machine) -> None:
    assert slide.plant.tree.joints[0].armature == pytest.approx(0.5e-4 * 100.0**2)


def test_orientation_turns_the_body_in_its_parent(slide: Machine) -> None:
    np.testing.assert_allclose(slide.plant.tree.bodies[0].orientation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


def test_orientation_angles_are_about_the_parents_axes_in_the_order_x_y_z() -> None:
    machine = machine_from_text(ONE_AXIS.replace("orientation_deg = [0.0, 0.0, 90.0]", "orientation_deg = [90.0, 0.0, 90.0]"))
    turned = machine.plant.tree.bodies[0].orientation @ np.eye(3)
    # about x first: y goes to z and z to -y; then about the parent's z: x to y and y to -x
    np.testing.assert_allclose(turned, np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]).T, atol=1e-15)


def test_what_the_file_leaves_out_is_open(slide: Machine) -> None:
    assert slide.bus is None
    assert slide.geometry is None
    assert slide.controllers == ()
    assert slide.limits[0].upper == math.inf
    assert slide.limits[0].unit == "m"
    np.testing.assert_array_equal(slide.plant.tree.gravity_m_s2, [0.0, 0.0, -9.81])


@pytest.mark.parametrize(
    ("dimension", "unit", "factor"),
    [
        ("angle", "deg", math.pi / 180.0),
        ("length", "um", 1e-6),
        ("rotational_stiffness", "Nm_deg", 180.0 / math.pi),
        ("inertia", "g_cm2", 1e-7),
        ("share", "permille", 1e-3),
        ("force", "kN", 1e3),
    ],
)
def test_factors_to_si(dimension: str, unit: str, factor: float) -> None:
    assert UNITS[dimension][unit] == pytest.approx(factor)


def test_an_eds_file_beside_the_machine_file_wins_over_the_shipped_one(tmp_path: Path) -> None:
    own = tmp_path / "isocenter_drive.eds"
    own.write_text("; own")
    path = tmp_path / "copy.toml"
    path.write_text(load_machine("carm").text)
    nodes = {node.name: node for node in load_machine(path).bus.nodes}
    assert nodes["roll_drive"].eds == own
    assert nodes["roll_encoder"].eds.parent != tmp_path


def test_effects_are_added_without_touching_the_file() -> None:
    carm = load_machine("carm")
    assert carm.with_effects(()).plant.effects == ()
    assert carm.with_effects(()).hash == carm.hash


def test_the_summary_names_every_body_and_node() -> None:
    carm = load_machine("carm")
    page = "\n".join(machine_lines(carm))
    document = machine_document(carm)
    for name in [body.name for body in carm.plant.tree.bodies] + [node.name for node in carm.bus.nodes]:
        assert name in page
    assert [axis["name"] for axis in document["axes"]] == list(carm.axes)
    assert document["bodies"][-1]["joint"]["name"] == "detector_mount"


@pytest.mark.parametrize(("name", "said"), [("carm", "7 degrees of freedom, "), ("emps", "1 degree of freedom, ")])
def test_the_summary_counts_degrees_of_freedom(name: str, said: str) -> None:
    assert said in machine_lines(load_machine(name))[1]
