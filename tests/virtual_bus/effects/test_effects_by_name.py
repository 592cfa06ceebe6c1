"""Effects files and refusals, over the whole catalogue."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from effect_examples import EXAMPLES
from places import CONCEALED_MACHINES
from small_plants import block

from hil.machine import load_machine
from hil.machine.effects_file import effects_from_text, effects_text
from virtual_bus.effects import nonlinear_stiffness
from virtual_bus.effects.binding import bind_effects
from virtual_bus.effects.bounds import effect_at
from virtual_bus.effects.motion import JointMotion
from virtual_bus.effects.places import part_at
from virtual_bus.effects.registry import effects
from virtual_bus.errors import EffectError
from virtual_bus.physics import Physics
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.plant.statics import equilibrium, static_effort, static_stiffness
from virtual_bus.settings import Body, Drive, EffectSetting, Joint, Tree

CARM, EMPS = load_machine("carm"), load_machine("emps")
SLIDER = load_machine(CONCEALED_MACHINES / "slider.toml")


def test_every_effect_is_written_and_read_back() -> None:
    chosen = tuple(EXAMPLES.values())
    assert effects_from_text(effects_text(chosen, CARM), CARM, "effects.toml") == chosen


def test_powers_in_units_are_written_as_in_recordings_and_left_out_of_keys() -> None:
    k3 = next(p for p in effects()["nonlinear_stiffness"].parameters if p.name == "k3")
    assert (k3.unit_at(prismatic=False), k3.key(prismatic=False)) == ("Nm/rad^3", "k3_Nm_rad3")
    assert (k3.unit_at(prismatic=True), k3.key(prismatic=True)) == ("N/m^3", "k3_N_m3")
    units = {p.unit_at(slides) for effect in effects().values() for p in effect.parameters for slides in (False, True)}
    assert not [unit for unit in units if re.search(r"[a-z]\d", unit)]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("nonlinear_stiffness", 'name = "nonlinear_stiffness"\nat = "propeller"\nk3_Nm_rad3 = 5e10\n'),
        ("backlash", 'name = "backlash"\nat = "roll"\nb_rad = 1e-4\n'),
    ],
)
def test_what_refines_a_spring_or_a_gap_may_be_left_out_of_its_file(name: str, text: str) -> None:
    assert effects_from_text(f"[[effect]]\n{text}", CARM, "effects.toml") == (EXAMPLES[name],)


def test_an_imu_s_low_pass_of_a_file_without_a_shape_is_the_machine_file_s_own_of_another_corner() -> None:
    (effect,) = effects_from_text('[[effect]]\nname = "imu_bandwidth"\nat = "imu"\nfc_Hz = 15.0\n', CARM, "effects.toml")
    plant = CARM.plant
    slow = replace(plant, imus=tuple(replace(imu, accelerometer_bandwidth_Hz=15.0, gyro_bandwidth_Hz=15.0) for imu in plant.imus))
    assert compile_plant(plant).model(effects=(effect,)).tobytes() == compile_plant(slow).model().tobytes()


def test_bristles_may_be_as_soft_as_a_slight_friction_that_gives_way_over_a_few_degrees() -> None:
    soft = EffectSetting("presliding_hysteresis", "roll", {"Fc": 0.006, "Fs_minus_Fc": 0.0, "vs": 0.06, "sigma0": 0.1, "sigma1": 0.0})
    assert effects_from_text(effects_text((soft,), CARM), CARM, "effects.toml") == (soft,)


@pytest.mark.parametrize("corner", [0.0, 0.05])
@pytest.mark.parametrize("bend", [0.0, 25.0, 100.0, 1200.0])
def test_a_softening_spring_softens_no_further_than_to_nothing(bend: float, corner: float) -> None:
    """Its slope is K - 3 abs(k3) tanh^2(r x) / bend, x beyond the corner; what softens it grows no more where that would be negative."""
    stiffness, k3 = 200.0, -1e4
    deflections = np.linspace(0.0, 0.5, 2001)
    softened = [
        nonlinear_stiffness.effort(JointMotion(x, 0.0, 0.0, 1.0, stiffness, x), k3, bend, corner, 0.0) for x in deflections.tolist()
    ]
    slopes = stiffness - np.diff(softened) / np.diff(deflections)
    middles = np.maximum(0.5 * (deflections[1:] + deflections[:-1]) - corner, 0.0)
    wanted = stiffness + 3.0 * k3 * (middles**2 if bend == 0.0 else np.tanh(np.sqrt(bend) * middles) ** 2 / bend)
    clear = np.abs(wanted) > 2.0  # of the corner
    assert np.any(wanted < 0.0) == (bend < 150.0)
    assert slopes[clear] == pytest.approx(np.where(wanted > 0.0, wanted, stiffness)[clear], abs=0.5)


@pytest.mark.parametrize("bend", [0.0, 25.0, 1200.0])
@pytest.mark.parametrize(("k3", "k2"), [(0.0, 1500.0), (-4e3, -900.0), (1e4, 4000.0), (1e4, 2000.0)])
def test_a_spring_that_softens_one_way_softens_no_further_than_to_nothing(k3: float, k2: float, bend: float) -> None:
    """Its slope is K + 2 k2 s + 3 k3 s^2, s = tanh(r x) / r, up to where that is first zero to either side, and K beyond."""
    stiffness = 200.0
    deflections = np.linspace(-0.5, 0.5, 4001)
    efforts = [nonlinear_stiffness.effort(JointMotion(x, 0.0, 0.0, 1.0, stiffness, x), k3, bend, 0.0, k2) for x in deflections.tolist()]
    slopes = stiffness - np.diff(efforts) / np.diff(deflections)
    x = 0.5 * (deflections[1:] + deflections[:-1])
    s = x if bend == 0.0 else np.tanh(np.sqrt(bend) * x) / np.sqrt(bend)
    wanted = stiffness + 2.0 * k2 * s + 3.0 * k3 * s**2
    clear = np.abs(wanted) > 5.0
    for side in (x > 0.0, x < 0.0):
        outwards = np.flatnonzero(side)[np.argsort(np.abs(x[side]))]
        gone = np.cumsum(wanted[outwards] <= 0.0) > 0
        wanted[outwards[gone]] = stiffness
        clear[outwards[gone][:1]] = False  # the knee is in it, or in the one before, which is not clear
    assert slopes[clear] == pytest.approx(wanted[clear], abs=2.5)


def test_bounds_are_wider_on_a_machine_of_more_effort() -> None:
    """As far as ten times what its drive gives: a damper of 18 kN is no friction of a small rail."""
    damper = {"name": "coulomb_friction", "at": "rail", "Fc_N": 18e3}
    with pytest.raises(EffectError, match="from 0 to 2000 N"):
        bind_effects([damper], block())
    strong = replace(block(), drives=(replace(block().drives[0], limit=2e4),))
    assert bind_effects([damper], strong) == (EffectSetting("coulomb_friction", "rail", {"Fc": 18e3}),)
    with pytest.raises(EffectError, match="from 0 to 200000 N"):
        bind_effects([damper | {"Fc_N": 2.1e5}], strong)


def test_bounds_of_what_hangs_behind_a_joint_are_by_the_drives_that_reach_it() -> None:
    """Effort over the root of the inertia: a slide of 4 kg on a shaft of 0.04 kg m^2 and 5000 Nm sees 50 kN, and ten times that at most."""
    turn = Joint("turn", "revolute", np.array([0.0, 0.0, 1.0]))
    slide = Joint("slide", "prismatic", np.array([1.0, 0.0, 0.0]), 1e5)
    bodies = (
        Body("shaft", "world", np.zeros(3), np.eye(3), 0.0, np.zeros(3), 0.04 * np.eye(3), turn),
        Body("slide", "shaft", np.zeros(3), np.eye(3), 4.0, np.zeros(3), np.zeros((3, 3)), slide),
    )
    plant = replace(block(), tree=Tree(bodies, np.zeros(3)), drives=(Drive("turn", "turn", "Nm", 1.0, 1.0, 5000.0, 0.0, 5000.0),))
    (level,) = effect_at("coulomb_friction", "slide", plant).parameters
    assert level.high == pytest.approx(5e5)
    (inertia,) = effect_at("added_inertia", "slide", plant).parameters
    assert (inertia.low, inertia.high) == (-1000.0, 1000.0)


def test_a_drive_of_large_commands_is_not_limited_by_a_neutral_limit() -> None:
    strong = replace(block(), drives=(replace(block().drives[0], limit=2e4),))
    limit = effect_at("current_saturation", "rail", strong).parameters[0]
    assert (limit.neutral, limit.high) == (2e5, 2e5)


def test_a_part_is_an_axis_with_what_it_carries_up_to_the_next_drive() -> None:
    of_imu = ("imu", "imu_z", "gyro_x")
    parts = {
        "roll": ("roll", "roll_rotor", "tube", "detector", "c_arc", "position_roll", "link_position_roll", "current_roll", *of_imu),
        "propeller": ("propeller", "propeller_rotor", "sleeve", "position_propeller", "current_propeller"),
        "ceiling_mount": ("ceiling_mount", "support_arm"),
    }
    assert {part: {part_at(at, CARM.plant) for at in places} for part, places in parts.items()} == {part: {part} for part in parts}
    assert {part_at(at, EMPS.plant) for at in ("carriage", "position_carriage")} == {"carriage"}


def test_a_joint_hangs_at_the_side_of_its_gap_that_its_load_chooses() -> None:
    gap = 2e-3
    pose = np.radians([0.0, 0.0])
    without = Physics(CARM.plant, noise=False)
    having = Physics(CARM.with_effects((EffectSetting("backlash", "roll", {"b": gap, "flank": 0.0}),)).plant, noise=False)
    for physics in (without, having):
        physics.place(pose)
    joint = CARM.plant.tree.joint_index("roll_gear")
    rest, hung = (physics.truth()["joint_position"][joint] for physics in (without, having))
    assert hung - rest == pytest.approx(np.sign(rest) * gap, rel=1e-2)


@pytest.mark.parametrize("gap", [1e-6, 5e-5, 2e-3])
@pytest.mark.parametrize(("axis", "sprung"), [("propeller", "propeller_gear"), ("roll", "roll_gear"), ("support_arm", "arm_yaw")])
def test_a_joint_rests_on_a_flank_of_its_gap_where_gravity_in_it_has_no_stable_place_as_well(axis: str, sprung: str, gap: float) -> None:
    """Upright, hanging with its own equilibrium far away, or about an upright axis, where next to no effort leaves it at the corner: within
    the gap gravity's gradient leads away from where the joint falls.
    """
    plant = compile_plant(CARM.with_effects((EffectSetting("backlash", axis, {"b": gap, "flank": 0.0}),)).plant)
    joint, held = CARM.plant.tree.joint_index(sprung), list(plant.joint_of_axis().values())
    free = [n for n in range(plant.joints) if n not in held]
    for pose in np.radians([[0.0, 0.0], [-40.0, 55.0], [-85.0, 89.0], [60.0, -70.0], [20.0, 5.0]]):
        q = equilibrium(plant, plant.model(), pose)
        stiffness = static_stiffness(plant, plant.model(), q)
        off_rad = np.linalg.solve(stiffness[np.ix_(free, free)], static_effort(plant, plant.model(), q)[free])
        assert np.abs(off_rad).max() < 1e-11
        assert stiffness[joint, joint] > 0.0


@pytest.mark.parametrize("gap_m", [1e-5, 2.5e-4, 1e-3])
@pytest.mark.parametrize("load_N", [-40.0, 0.01, 3.0])
def test_a_load_on_a_level_belt_rests_on_the_flank_that_it_is_pushed_to(gap_m: float, load_N: float) -> None:
    """In the gap nothing pulls back, not even gravity."""
    acting = (EffectSetting("backlash", "carriage", {"b": gap_m, "flank": 0.0}), EffectSetting("constant_load", "load", {"tau0": load_N}))
    plant = compile_plant(SLIDER.with_effects(acting).plant)
    q = equilibrium(plant, plant.model(), np.array([0.1]))
    belt = SLIDER.plant.tree.joint_index("belt")
    assert q[belt] == pytest.approx(np.sign(load_N) * gap_m + load_N / 45000.0, rel=1e-9)


@pytest.mark.parametrize(
    ("entry", "hint"),
    [
        ({"name": "backlash", "at": "carriage", "b_m": 1e-4}, "with a sprung joint"),
        ({"name": "axis_coupling", "at": "carriage", "J12_kg": 1.0, "phi_rad": 0.0}, "beside another axis"),
        ({"name": "clock_offset", "at": "imu", "t0_s": 0.0, "delta": 0.0}, "position_carriage"),
        ({"name": "current_saturation", "at": "carriage", "imax_A": 1.0, "droop_V_s_m": 0.0}, "imax_V"),
    ],
)
def test_a_place_that_cannot_have_it_is_refused_in_one_line(entry: dict, hint: str) -> None:
    with pytest.raises(EffectError) as refusal:
        bind_effects([entry], EMPS.plant, "effects.toml")
    assert hint in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_coupling_larger_than_what_it_couples_is_refused() -> None:
    with pytest.raises(EffectError, match="axis_coupling"):
        Physics(CARM.with_effects((EffectSetting("axis_coupling", "propeller", {"J12": 450.0, "phi": 0.0}),)).plant)


def test_a_delay_longer_than_a_drive_remembers_is_refused() -> None:
    with pytest.raises(EffectError, match="remembers"):
        Physics(EMPS.with_effects((EffectSetting("delay", "carriage", {"Td": 0.02}),)).plant)
