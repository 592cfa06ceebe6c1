"""What a compiled plant promises around its equations: parameters by name, refusals, a cache that later processes use."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import SUPPORT
from small_plants import BLOCK_MASS_kg, block, gantry

from hil.machine.load import load_machine
from virtual_bus.errors import PlantError
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.generate import plant_text
from virtual_bus.settings import Body, PlantSettings


def with_body(settings: PlantSettings, which: str, **changes: object) -> PlantSettings:
    bodies = tuple(replace(body, **changes) if body.name == which else body for body in settings.tree.bodies)
    return replace(settings, tree=replace(settings.tree, bodies=bodies))


def test_parameters_have_names_units_and_the_files_values() -> None:
    settings = load_machine("carm").plant
    by_name = {parameter.name: parameter for parameter in compile_plant(settings).parameters}
    arc = next(body for body in settings.tree.bodies if body.name == "c_arc")
    sway = next(joint for joint in settings.tree.joints if joint.name == "mount_sway")
    assert by_name["c_arc.mass_kg"].value == arc.mass_kg
    assert by_name["mount_sway.stiffness_Nm_rad"].value == sway.stiffness
    assert by_name["mount_sway.damping_Nm_s_rad"].unit == "Nm s/rad"
    assert by_name["roll.armature_kg_m2"].value > 0.0
    assert by_name["roll.constant_Nm_A"].unit == "Nm/A"
    assert by_name["roll.armature_kg_m2"].unit == "kg m^2"
    assert by_name["gravity.z_m_s2"].value == -9.81
    assert by_name["gravity.z_m_s2"].unit == "m/s^2"


def test_an_unknown_parameter_is_answered_with_its_neighbours() -> None:
    with pytest.raises(PlantError, match=r"block\.mass_kg"):
        compile_plant(block()).with_values({"block.mas_kg": 1.0})


@pytest.mark.parametrize(
    ("settings", "hint"),
    [
        (with_body(gantry(), "lift", parent="pillar"), "parent 'pillar'"),
        (with_body(gantry(), "lift", name="cart"), "used twice"),
        (with_body(gantry(), "cart", mass_kg=-1.0), "mass_kg = -1.0"),
        (with_body(gantry(), "bob", inertia_kg_m2=np.diag([1.0, 1.0, 3.0])), "principal values"),
        (with_body(gantry(), "bob", mass_kg=0.0, inertia_kg_m2=np.zeros((3, 3))), "nothing behind it has inertia"),
        (replace(gantry(), drives=(replace(gantry().drives[0], joint="wheel"),)), "no such joint"),
        (replace(gantry(), watched_bodies=("hook",)), "no such body"),
        (replace(gantry(), substeps=0), "must be positive"),
    ],
)
def test_what_is_no_plant_is_refused_in_one_line(settings: PlantSettings, hint: str) -> None:
    with pytest.raises(PlantError) as refusal:
        compile_plant(settings)
    assert hint in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_an_axis_that_is_no_unit_vector_is_refused() -> None:
    cart: Body = gantry().tree.bodies[0]
    assert cart.joint is not None
    with pytest.raises(PlantError, match="unit vector"):
        compile_plant(with_body(gantry(), "cart", joint=replace(cart.joint, axis=np.array([1.0, 1.0, 0.0]))))


@pytest.mark.slow
def test_a_later_process_loads_the_plant_without_compiling() -> None:
    compile_plant(block()).advance(*_arguments())
    code = (
        "from small_plants import block\nimport test_compiled_plant as here\n"
        "from virtual_bus.plant.compiled import compile_plant\n"
        "plant = compile_plant(block())\nplant.advance(*here._arguments())\n"
        "print(sum(plant.advance.stats.cache_hits.values()), sum(plant.advance.stats.cache_misses.values()))"
    )
    path = os.pathsep.join((str(SUPPORT), os.environ.get("PYTHONPATH", "")))
    environment = os.environ | {"PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=Path(__file__).parent, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["1", "0"]


def _arguments() -> tuple[np.ndarray, ...]:
    plant = compile_plant(block())
    return plant.new_state(np.zeros(1)), np.zeros(1), np.zeros(1), plant.model(), plant.new_work()


def test_stiff_joints_get_more_inner_steps_and_ring_down_as_they_should() -> None:
    stiffness, damping = 2.0e8, 50.0  # 1600 Hz at a step of 3.9 ms
    plant = compile_plant(block(stiffness=stiffness, damping=damping, substeps=1))
    model, work = plant.model(), plant.new_work()
    assert model[0].inner_steps > 30
    state = plant.new_state(np.array([1e-3]))
    for _ in range(64):
        plant.advance(state, np.zeros(1), np.zeros(1), model, work)
    amplitude = np.hypot(state[0], state[1] / np.sqrt(stiffness / BLOCK_MASS_kg))
    assert amplitude == pytest.approx(1e-3 * np.exp(-damping / (2.0 * BLOCK_MASS_kg) * 64.0 / 256.0), rel=0.01)


def _changed(settings: PlantSettings) -> dict[str, PlantSettings]:
    """Plants that differ from this one in one thing that its equations show."""
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    tree, last = settings.tree, settings.tree.bodies[-1]
    moving = next(body for body in tree.bodies if body.joint is not None)
    assert moving.joint is not None
    slides = "prismatic" if moving.joint.kind == "revolute" else "revolute"
    return {
        "parent": with_body(settings, last.name, parent=tree.bodies[0].name),
        "orientation": with_body(settings, last.name, orientation=last.orientation @ turned),
        "welded": with_body(settings, last.name, joint=None),
        "axis": with_body(settings, moving.name, joint=replace(moving.joint, axis=np.roll(moving.joint.axis, 1))),
        "kind": with_body(settings, moving.name, joint=replace(moving.joint, kind=slides)),
        "a zero": with_body(settings, last.name, center_of_mass_m=np.zeros(3), position_m=np.zeros(3)),
        "gravity": replace(settings, tree=replace(tree, gravity_m_s2=np.roll(tree.gravity_m_s2, 1))),
        "drives": replace(settings, drives=settings.drives[::-1]),
        "an IMU's axes": replace(settings, imus=tuple(replace(imu, orientation=imu.orientation @ turned) for imu in settings.imus)),
        "an IMU's body": replace(settings, imus=tuple(replace(imu, body=moving.name) for imu in settings.imus)),
        "no IMU": replace(settings, imus=settings.imus[1:]),
        "watched": replace(settings, watched_bodies=(tree.bodies[0].name,)),
    }


def test_plants_share_what_is_written_if_they_differ_in_numbers_alone() -> None:
    settings = load_machine("carm").plant
    heavier = replace(
        settings, tree=replace(settings.tree, bodies=tuple(replace(b, mass_kg=1.1 * b.mass_kg) for b in settings.tree.bodies))
    )
    assert plant_text(heavier) is plant_text(settings)
    for what, changed in _changed(settings).items():
        assert plant_text(changed) != plant_text(settings), what
