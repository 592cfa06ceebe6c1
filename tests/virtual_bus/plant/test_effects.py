"""Effects by name: the catalogue, what it refuses, and that a choice of effects needs no compilation."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from small_plants import block

from hil.machine.load import load_machine
from hil.machine.mjcf import to_mjcf
from virtual_bus.effects import catalogue
from virtual_bus.effects.binding import as_entries, bind_effects
from virtual_bus.errors import EffectError
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting


def test_the_catalogue_says_what_a_reader_needs_of_every_effect() -> None:
    entries = {entry["name"]: entry for entry in catalogue()}
    assert {"coulomb_friction", "stribeck_friction"} <= set(entries)
    for entry in entries.values():
        assert entry["convention"]
        assert entry["source"]
        assert entry["at"]
        for parameter in entry["parameters"]:
            assert parameter["low"] < parameter["high"]
            assert parameter["description"]
    coulomb = entries["coulomb_friction"]["parameters"][0]
    assert (coulomb["key"], coulomb["unit"]) == ("Fc_Nm", "Nm")
    assert (coulomb["key_prismatic"], coulomb["unit_prismatic"]) == ("Fc_N", "N")


def test_effects_are_bound_with_the_units_of_their_joint() -> None:
    revolute = {"name": "coulomb_friction", "at": "roll", "Fc_Nm": 12.0}
    assert bind_effects([revolute], load_machine("carm").plant) == (EffectSetting("coulomb_friction", "roll", {"Fc": 12.0}),)
    prismatic = {"name": "stribeck_friction", "at": "rail", "Fs_minus_Fc_N": 3.0, "vs_m_s": 0.01, "delta": 2.0}
    bound = bind_effects([prismatic], block())
    assert bound == (EffectSetting("stribeck_friction", "rail", {"Fs_minus_Fc": 3.0, "vs": 0.01, "delta": 2.0}),)
    assert as_entries(bound, block()) == [prismatic]


@pytest.mark.parametrize(
    ("entry", "hint"),
    [
        ({"name": "coulomb_frction", "at": "rail", "Fc_N": 1.0}, "did you mean coulomb_friction"),
        ({"at": "rail", "Fc_N": 1.0}, "no such effect"),
        ({"name": "coulomb_friction", "Fc_N": 1.0}, "rail"),
        ({"name": "coulomb_friction", "at": "imu", "Fc_N": 1.0}, "acts at an axis or body"),
        ({"name": "coulomb_friction", "at": "rail", "Fc_Nm": 1.0}, "it takes Fc_N"),
        ({"name": "coulomb_friction", "at": "rail"}, "Fc_N is missing"),
        ({"name": "coulomb_friction", "at": "rail", "Fc_N": -1.0}, "from 0 to 2000 N"),
        ({"name": "coulomb_friction", "at": "rail", "Fc_N": float("nan")}, "from 0 to 2000 N"),
        ({"name": "coulomb_friction", "at": "rail", "Fc_N": "much"}, "must be a number"),
        ({"name": "coulomb_friction", "at": "rail", "Fc_N": True}, "must be a number"),
    ],
)
def test_a_wrong_effect_is_refused_in_one_line_that_helps(entry: dict, hint: str) -> None:
    with pytest.raises(EffectError) as refusal:
        bind_effects([entry], block(), "effects.toml")
    text = str(refusal.value)
    assert text.startswith("effects.toml: effect 1")
    assert hint in text
    assert "\n" not in text


def test_the_same_effect_twice_at_one_place_is_refused() -> None:
    entry = {"name": "coulomb_friction", "at": "rail", "Fc_N": 1.0}
    with pytest.raises(EffectError, match="given twice"):
        bind_effects([entry, entry], block())


def test_a_wave_over_position_may_act_at_a_place_with_several_orders() -> None:
    first = {"name": "cogging", "at": "rail", "Np_rad_m": 70.0, "A1_N": 1.0, "phi1_rad": 0.0, "A2_N": 0.0, "phi2_rad": 0.0}
    bound = bind_effects([first, {**first, "Np_rad_m": 90.0}], block())
    assert [effect.parameters["Np"] for effect in bound] == [70.0, 90.0]
    with pytest.raises(EffectError, match="given twice"):
        bind_effects([first, {**first, "A1_N": 2.0}], block())
    several = {entry["name"]: entry["several"] for entry in catalogue() if entry["several"]}
    assert several == {"cogging": "Np"}


def test_another_choice_of_effects_is_the_same_compiled_plant() -> None:
    without, with_friction = compile_plant(block()), compile_plant(block(effects=(EffectSetting("coulomb_friction", "rail", {"Fc": 1.0}),)))
    assert without.module is with_friction.module


@pytest.mark.parametrize(("at", "joint", "added"), [("roll", "roll", 12.0), ("roll", "roll", -20.0), ("c_arc", "roll_gear", 5.0)])
def test_an_added_inertia_moves_the_machine_as_mujoco_s_armature_does(at: str, joint: str, added: float) -> None:
    """In a pose in motion, under gravity, of the C-arm: which accelerations its drives give it."""
    settings = load_machine("carm").plant
    model = mujoco.MjModel.from_xml_string(to_mjcf(settings, "carm"))
    model.dof_armature[settings.tree.joint_index(joint)] += added
    data = mujoco.MjData(model)
    rng = np.random.default_rng(6)
    data.qpos[:], data.qvel[:], data.ctrl[:] = 0.2 * rng.normal(size=model.nq), 0.3 * rng.normal(size=model.nv), [2.0, -3.0]
    mujoco.mj_forward(model, data)
    plant = compile_plant(settings)
    state, work = plant.new_state(data.qpos), plant.new_work()
    state[plant.joints : 2 * plant.joints] = data.qvel
    effects = (EffectSetting("added_inertia", at, {"J": added}),)
    plant.joint_acceleration(state, data.ctrl.copy(), np.zeros(2), plant.model(None, effects), work)
    np.testing.assert_allclose(work["acceleration"][0], data.qacc, rtol=1e-9, atol=1e-9)
