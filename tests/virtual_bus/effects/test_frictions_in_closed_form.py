"""Frictions of a block on a rail whose motion can be written down."""

from __future__ import annotations

import numpy as np
import pytest
from small_plants import BLOCK_MASS_kg, block, run

from virtual_bus.settings import EffectSetting

PERIOD_s = 1.0 / 256.0
M = BLOCK_MASS_kg
FORCE_N, SHARE = 6.0, 0.3


def test_a_gear_gives_its_motors_effort_less_a_share_when_it_drives_and_more_when_it_brakes() -> None:
    effect = EffectSetting("motor_load_friction", "rail", {"Km": SHARE})
    forces = np.concatenate([np.full(64, FORCE_N), np.zeros(64), np.full(32, -FORCE_N)])
    states = run(block(effects=(effect,)), forces[:, None])
    speeds = states[:, 1]
    driven, braked = (1.0 - SHARE) * FORCE_N / M, (1.0 + SHARE) * FORCE_N / M
    reached = driven * 64 * PERIOD_s
    np.testing.assert_allclose(speeds[:65], driven * PERIOD_s * np.arange(65), rtol=1e-9)
    np.testing.assert_allclose(speeds[64:129], reached, rtol=1e-9)  # a motor without effort takes none
    np.testing.assert_allclose(speeds[128:], reached - braked * PERIOD_s * np.arange(33), rtol=1e-9)


def test_the_joints_damper_is_no_effort_of_the_motor() -> None:
    """At its end speed a voltage F on a damper D is all back-EMF: the gear carries nothing, and takes nothing."""
    damping = 50.0
    effect = EffectSetting("motor_load_friction", "rail", {"Km": SHARE})
    states = run(block(damping=damping, effects=(effect,)), np.full((256, 1), FORCE_N))
    time_s = PERIOD_s * np.arange(257)
    rate = (1.0 - SHARE) * damping / M  # m v' = (1 - share) (F - D v)
    np.testing.assert_allclose(states[:, 1], FORCE_N / damping * (1.0 - np.exp(-rate * time_s)), atol=2e-4 * FORCE_N / damping)


def test_a_motor_that_pushes_against_a_weight_holds_it_up_to_a_share_of_its_effort() -> None:
    weight = EffectSetting("constant_load", "rail", {"tau0": -5.0})
    effect = EffectSetting("motor_load_friction", "rail", {"Km": SHARE})
    held, lifted = 5.0 / (1.0 + SHARE), 5.0 / (1.0 - SHARE)
    for force, moves in ((0.99 * held, -1.0), (1.01 * held, 0.0), (0.99 * lifted, 0.0), (1.01 * lifted, 1.0)):
        speed = run(block(effects=(weight, effect)), np.full((64, 1), force))[-1, 1]
        assert np.sign(np.round(speed, 9)) == moves, force


@pytest.mark.parametrize("exponent", [0.3, 0.5, 2.0 / 3.0, 0.8])
def test_a_power_law_brings_a_coasting_block_to_rest_in_a_finite_time(exponent: float) -> None:
    strength, begin = 3.0, 0.8
    effect = EffectSetting("power_law_friction", "rail", {"F1": strength, "p": exponent})
    states = run(block(effects=(effect,), substeps=16), np.zeros((256, 1)), start=np.array([0.0, begin]))
    time_s = PERIOD_s * np.arange(257)
    left = np.maximum(begin ** (1.0 - exponent) - (1.0 - exponent) * strength / M * time_s, 0.0)  # m v' = -F1 v^p
    exact = left ** (1.0 / (1.0 - exponent))
    slides = exact > 0.05 * begin
    np.testing.assert_allclose(states[slides, 1], exact[slides], rtol=1e-3)
    np.testing.assert_allclose(states[:, 1], exact, atol=2e-3)  # creeping it is viscous
