"""Friction against closed forms: sliding, stopping, holding, breaking away, and what step halving does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_plants import BLOCK_MASS_kg, block, run

from virtual_bus.settings import EffectSetting, PlantSettings

PERIOD_s = 1.0 / 256.0
POSITION, SPEED = 0, 1  # of the block's state


def coulomb(level_N: float) -> EffectSetting:
    return EffectSetting("coulomb_friction", "rail", {"Fc": level_N})


def stribeck(excess_N: float, speed_m_s: float, exponent: float = 2.0) -> EffectSetting:
    return EffectSetting("stribeck_friction", "rail", {"Fs_minus_Fc": excess_N, "vs": speed_m_s, "delta": exponent})


def pushed(settings: PlantSettings, force_N: float, seconds: float, start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    return run(settings, np.full((round(seconds / PERIOD_s), 1), force_N), np.array(start))


@pytest.mark.parametrize("speed", [0.7, -1.3])
def test_a_sliding_block_stops_after_m_v2_over_2_Fc_and_stays(speed: float) -> None:
    states = pushed(block(effects=(coulomb(5.0),)), 0.0, 1.0, (0.0, speed))
    distance = np.sign(speed) * BLOCK_MASS_kg * speed**2 / (2.0 * 5.0)
    step_s = PERIOD_s / 4
    assert states[-1, POSITION] == pytest.approx(distance, abs=5.0 / BLOCK_MASS_kg * step_s**2)
    stopped = round(BLOCK_MASS_kg * abs(speed) / 5.0 / PERIOD_s) + 2
    assert np.ptp(states[stopped:, POSITION]) == 0.0


def test_while_it_slides_coulomb_friction_is_exact() -> None:
    states = pushed(block(effects=(coulomb(5.0),)), 0.0, 0.2, (0.0, 1.0))
    time_s = np.arange(len(states)) * PERIOD_s
    np.testing.assert_allclose(states[:, POSITION], time_s - 0.5 * 5.0 / BLOCK_MASS_kg * time_s**2, rtol=0, atol=1e-13)


@pytest.mark.parametrize("force", [4.999, -4.999])
def test_below_break_away_nothing_moves(force: float) -> None:
    states = pushed(block(effects=(coulomb(5.0),)), force, 2.0)
    assert np.abs(states[:, POSITION]).max() < 1e-15
    np.testing.assert_allclose(states[1:, 3], -force, rtol=1e-12)  # the friction itself


def test_above_break_away_the_rest_of_the_force_accelerates() -> None:
    states = pushed(block(effects=(coulomb(5.0),)), 6.0, 1.0)
    assert states[-1, SPEED] == pytest.approx((6.0 - 5.0) / BLOCK_MASS_kg, rel=1e-12)


def test_stribeck_friction_holds_its_excess_on_top_of_coulomb() -> None:
    settings = block(effects=(coulomb(5.0), stribeck(3.0, 0.01)))
    assert np.abs(pushed(settings, 7.99, 1.0)[:, POSITION]).max() < 1e-15
    assert pushed(settings, 8.01, 1.0)[-1, SPEED] > 1.0  # nearly (8.01 - 5) / 2 once the excess is left behind


def test_stribeck_friction_slides_as_its_equation_says() -> None:
    excess, speed, exponent = 3.0, 0.2, 1.5
    settings = block(effects=(coulomb(5.0), stribeck(excess, speed, exponent)), substeps=16)

    def motion(_: float, v: np.ndarray) -> np.ndarray:
        return (6.0 - 5.0 - excess * np.exp(-((v / speed) ** exponent))) / BLOCK_MASS_kg

    states = pushed(settings, 6.0, 1.0, (0.0, 0.5))
    exact = solve_ivp(motion, (0.0, 1.0), [0.5], rtol=1e-11, atol=1e-12)
    assert states[-1, SPEED] == pytest.approx(exact.y[0, -1], rel=1e-6)


def test_a_sprung_block_loses_2_Fc_over_k_every_half_turn_and_stops_where_friction_holds_the_spring() -> None:
    samples = 20  # per half turn, so that rows fall on the turns
    stiffness = BLOCK_MASS_kg * (np.pi / (samples * PERIOD_s)) ** 2
    level, start = 0.005 * stiffness, 0.0523
    states = pushed(block(stiffness=stiffness, effects=(coulomb(level),), substeps=16), 0.0, 2.0, (start, 0.0))
    turns = [start]
    while abs(turns[-1]) > level / stiffness:
        turns.append(-np.sign(turns[-1]) * (abs(turns[-1]) - 2.0 * level / stiffness))
    np.testing.assert_allclose(states[: samples * len(turns) : samples, POSITION], turns, rtol=0, atol=1e-7)
    assert states[-1, POSITION] == pytest.approx(turns[-1], abs=1e-7)
    assert abs(states[-1, SPEED]) < 1e-15


def test_the_error_falls_with_the_square_of_the_step_through_sticking_and_slipping() -> None:
    time_s = np.arange(768)[:, None] * PERIOD_s
    forces = 9.0 * np.sin(2.0 * np.pi * 1.3 * time_s) + 2.0 * np.sin(2.0 * np.pi * 7.0 * time_s)

    def at(substeps: int) -> np.ndarray:
        effects = (coulomb(5.0), stribeck(1.5, 0.05))
        return run(block(stiffness=150.0, damping=2.0, effects=effects, substeps=substeps), forces)[:, POSITION]

    converged = at(512)
    errors = [float(np.sqrt(np.mean((at(substeps) - converged) ** 2))) for substeps in (2, 8, 32)]
    assert errors[0] < 1e-3 * np.ptp(converged)
    assert errors[0] / errors[1] > 10.0  # sixteen, up to where the events fall within a step
    assert errors[1] / errors[2] > 10.0


def test_a_closed_brake_holds_up_to_its_effort_and_an_open_one_does_not() -> None:
    held = run(block(brake_effort=50.0), np.full((100, 1), 49.9), brakes=np.ones(1))
    slipping = run(block(brake_effort=50.0), np.full((100, 1), 52.0), brakes=np.ones(1))
    free = run(block(brake_effort=50.0), np.full((100, 1), 49.9), brakes=np.zeros(1))
    assert np.abs(held[:, POSITION]).max() < 1e-15
    assert slipping[-1, SPEED] == pytest.approx(2.0 / BLOCK_MASS_kg * 100 * PERIOD_s)
    assert free[-1, SPEED] == pytest.approx(49.9 / BLOCK_MASS_kg * 100 * PERIOD_s)
