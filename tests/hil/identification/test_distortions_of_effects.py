"""Claims about which unexcited lines an effect of the emulated C-arm reaches: odd effects odd lines, even ones even lines."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_loop import orthogonal_multisine

from hil.identification import periodic_records, robust_bla
from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from virtual_bus.settings import EffectSetting

PERIOD, SETTLE, PERIODS, REALISATIONS = 1280, 4, 3, 2
ODD = np.arange(5, 160, 2)  # 1 to 32 Hz
LINES = np.setdiff1d(ODD, ODD[2::4])  # one odd line in four detects, and every even one
BALANCED_DEG = -46.52  # roll at which it holds itself: no gear is wound up
EXCITATION_RMS_A = 0.3
NOISE = 2e-6  # rad, on the encoders: the plant's own even distortion, its geometry's, stays below
ROLL = 1


def distortion_of_roll(*effects: EffectSetting, roll_deg: float = BALANCED_DEG) -> tuple[float, float]:
    """Levels over noise on even and on odd unexcited lines of the roll encoder."""
    simulator, rng = Simulator(load_machine("carm").with_effects(effects)), np.random.default_rng(90)
    pose, rows = np.radians([0.0, roll_deg]), (SETTLE + PERIODS) * PERIOD
    y, u, w = (np.empty((REALISATIONS, 2, rows, 2)) for _ in range(3))
    for m in range(REALISATIONS):
        period = orthogonal_multisine(rng, PERIOD, LINES)
        w[m] = np.tile(period * EXCITATION_RMS_A / period.std(), (1, SETTLE + PERIODS, 1))
        for e in range(2):
            noise = NOISE * rng.standard_normal((rows, 2))
            run = simulator.run(Inputs(np.tile(pose, (rows, 1)) - noise, w[m, e], np.zeros((rows, 2)), None, pose))
            y[m, e], u[m, e] = run.position + noise, run.command
    records = periodic_records(y, u, w, period_samples=PERIOD, sample_rate_Hz=256.0, settle_periods=SETTLE)
    found = robust_bla(records).even_odd
    share = found.level[:, ROLL] / found.noise[:, ROLL]
    return share[found.even].mean(), share[~found.even].mean()


def test_the_plain_machine_shows_none_beyond_chance() -> None:
    """What is left of a mean square less the noise's, where it is not negative: 0.2 to 0.4 of the noise with these few records."""
    even, odd = distortion_of_roll()
    assert even < 1.0
    assert odd < 1.0


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("coulomb_friction", {"Fc": 3.0}),
        ("nonlinear_stiffness", {"k3": 3e12, "bend": 0.0, "corner": 0.0, "k2": 0.0}),
    ],
)
def test_odd_effects_reach_odd_lines_only(name: str, parameters: dict[str, float]) -> None:
    even, odd = distortion_of_roll(EffectSetting(name, "roll", parameters))
    assert odd > 100.0
    assert even < 1.0


def test_friction_that_differs_with_direction_reaches_even_lines() -> None:
    """Different viscous coefficients are a mean one and one of |speed|. Coulomb levels: a mean and a constant."""
    even, odd = distortion_of_roll(
        EffectSetting("asymmetric_friction", "roll", {"Fc_plus": 0.0, "Fc_minus": 0.0, "Fv_plus": 600.0, "Fv_minus": 100.0})
    )
    assert even > 100.0
    assert odd < 2.0


def test_a_wound_up_cubic_spring_reaches_both() -> None:
    """Away from balance its holding effort adds a square to the cube."""
    even, odd = distortion_of_roll(
        EffectSetting("nonlinear_stiffness", "roll", {"k3": 3e12, "bend": 0.0, "corner": 0.0, "k2": 0.0}), roll_deg=0.0
    )
    assert even > 5.0
    assert odd > 50.0
