"""Frictions of a block on a rail whose motion can be written down."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_plants import BLOCK_MASS_kg, block, run

from virtual_bus.settings import Body, Drive, EffectSetting, Joint, PlantSettings, Tree

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


MOTOR, GRAVITY = 0.3, 0.2
"""Shares of the motor's effort and of gravity's that a gear rubs with."""


def test_a_gear_that_holds_a_weight_rubs_with_shares_of_both_its_sides() -> None:
    """Motor F up, weight W down: it holds while abs(F - W) is within MOTOR F + GRAVITY W."""
    weight = EffectSetting("constant_load", "rail", {"tau0": -5.0})
    effect = EffectSetting("transmitted_load_friction", "rail", {"Km": MOTOR, "Kg": GRAVITY})
    lowest, highest = 5.0 * (1.0 - GRAVITY) / (1.0 + MOTOR), 5.0 * (1.0 + GRAVITY) / (1.0 - MOTOR)
    for force, moves in ((0.99 * lowest, -1.0), (1.01 * lowest, 0.0), (0.99 * highest, 0.0), (1.01 * highest, 1.0)):
        speed = run(block(effects=(weight, effect)), np.full((64, 1), force))[-1, 1]
        assert np.sign(np.round(speed, 9)) == moves, force


def test_a_motor_that_pulls_with_the_weight_unloads_its_gear() -> None:
    """Both accelerate the block: the gear transmits the difference of what each side loses to it."""
    pulled = EffectSetting("constant_load", "rail", {"tau0": 5.0})
    effect = EffectSetting("transmitted_load_friction", "rail", {"Km": MOTOR, "Kg": GRAVITY})
    states = run(block(effects=(pulled, effect)), np.full((64, 1), FORCE_N))
    net = FORCE_N + 5.0 - abs(MOTOR * FORCE_N - GRAVITY * 5.0)
    np.testing.assert_allclose(states[:, 1], net / M * PERIOD_s * np.arange(65), rtol=1e-9)


def test_what_a_gear_rubs_more_at_rest_is_gone_at_speed() -> None:
    weight = EffectSetting("constant_load", "rail", {"tau0": -2.0})
    shares = {"Km": 0.1, "Kg": 0.05, "Km_rest": 0.2, "Kg_rest": 0.1, "vs": 0.3, "delta": 1.5}
    effect = EffectSetting("transmitted_load_friction", "rail", shares)
    states = run(block(effects=(weight, effect), substeps=16), np.full((128, 1), FORCE_N))

    def motion(_: float, v: np.ndarray) -> np.ndarray:
        level = 0.1 * FORCE_N + 0.05 * 2.0 + (0.2 * FORCE_N + 0.1 * 2.0) * np.exp(-((v / 0.3) ** 1.5))
        return (FORCE_N - 2.0 - level) / M

    exact = solve_ivp(motion, (0.0, 128 * PERIOD_s), [0.0], t_eval=PERIOD_s * np.arange(129), rtol=1e-9, atol=1e-12).y[0]
    np.testing.assert_allclose(states[:, 1], exact, rtol=0, atol=2e-5)


def test_a_joint_whose_friction_is_lower_at_rest_creeps_at_the_speed_at_which_it_holds_the_force() -> None:
    """4 - 3 exp(-(v / vs)^2) = 2 N."""
    friction = (
        EffectSetting("coulomb_friction", "rail", {"Fc": 4.0}),
        EffectSetting("stribeck_friction", "rail", {"Fs_minus_Fc": -3.0, "vs": 0.2, "delta": 2.0}),
    )
    assert run(block(effects=friction), np.full((512, 1), 0.99))[-1, 1] == 0.0
    assert run(block(effects=friction), np.full((512, 1), 2.0))[-1, 1] == pytest.approx(0.2 * np.sqrt(np.log(1.5)), rel=1e-5)


def test_frictions_together_never_push() -> None:
    friction = (
        EffectSetting("coulomb_friction", "rail", {"Fc": 1.0}),
        EffectSetting("stribeck_friction", "rail", {"Fs_minus_Fc": -5.0, "vs": 0.2, "delta": 2.0}),
    )
    speeds = run(block(effects=friction), np.zeros((64, 1)), start=np.array([0.0, 0.05]))[:, 1]
    np.testing.assert_allclose(speeds, 0.05, rtol=1e-12)


RIDER_kg, STIFFNESS, STRETCH_m = 2.0, 800.0, 0.05
SWINGS = 6  # in a second


def rider(*effects: EffectSetting) -> np.ndarray:
    """Deflections of a rider that swings on its spring from STRETCH_m on, upon a cart that is as good as fixed."""
    x = np.array([1.0, 0.0, 0.0])
    cart = Body("cart", "world", np.zeros(3), np.eye(3), 1e9, np.zeros(3), np.eye(3), Joint("cart", "prismatic", x))
    spring = Joint("spring", "prismatic", x, STIFFNESS)
    body = Body("rider", "cart", np.zeros(3), np.eye(3), RIDER_kg, np.zeros(3), np.eye(3), spring)
    settings = PlantSettings(
        tree=Tree((cart, body), np.zeros(3)), drives=(Drive("cart", "cart", "N", 1.0, 1.0, 60.0, 0.0, 60.0),), encoders=(), currents=(),
        imus=(), thermometers=(), sample_period_s=1.0 / 1000.0, substeps=1, effects=effects,
    )  # fmt: skip
    return run(settings, np.zeros((1000, 1)), start=np.array([0.0, STRETCH_m]))[:, 1]


def turning_points(x: np.ndarray) -> np.ndarray:
    """Extremes of a swing, by parabolas through the three rows about each."""
    k = 1 + np.flatnonzero((x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) < 0.0)
    before, at, after = x[k - 1], x[k], x[k + 1]
    return np.abs(at - 0.125 * (after - before) ** 2 / (after - 2.0 * at + before))


def test_dry_friction_on_a_spring_takes_the_same_from_every_swing() -> None:
    """2 Fc / K (Den Hartog 1956)."""
    swings = turning_points(rider(EffectSetting("coulomb_friction", "rider", {"Fc": 1.2})))
    expected = STRETCH_m - 2.0 * 1.2 / STIFFNESS * np.arange(1, SWINGS + 1)
    np.testing.assert_allclose(swings, expected, rtol=0, atol=1e-5)


def test_a_joint_behind_a_spring_rubs_by_what_the_spring_transmits() -> None:
    """Inwards the spring is weaker by the share, outwards stronger: swings shrink by the root of the ratio."""
    swings = turning_points(rider(EffectSetting("motor_load_friction", "rider", {"Km": 0.1})))
    np.testing.assert_allclose(swings, STRETCH_m * np.sqrt(0.9 / 1.1) ** np.arange(1, SWINGS + 1), rtol=2e-3)


def test_a_damper_on_a_spring_takes_a_share_of_every_swing() -> None:
    damping = 4.0
    swings = turning_points(rider(EffectSetting("viscous_friction", "rider", {"Fv": damping})))
    ratio = damping / (2.0 * np.sqrt(STIFFNESS * RIDER_kg))
    np.testing.assert_allclose(swings, STRETCH_m * np.exp(-np.pi * ratio / np.sqrt(1.0 - ratio**2)) ** np.arange(1, SWINGS + 1), rtol=1e-4)
