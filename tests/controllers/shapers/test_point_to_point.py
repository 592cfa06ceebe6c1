"""Point-to-point shapers leave the vibration they promise: held against the impulse response of the mode itself."""

from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.errors import DesignError
from controllers.shapers.conditions import Condition, cancelling, residuals
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.point_to_point import ei, multi_mode, two_hump_ei, zv, zvd
from controllers.shapers.sampled import on_samples


def residual_vibration(shaper: DelayFilter, frequency: float, damping: float) -> float:
    """Singer and Seering: amplitude of a mode after impulses A_k at t_k, over that after one impulse at the last t_k."""
    damped = frequency * np.sqrt(1.0 - damping**2)
    grown = shaper.gains * np.exp(damping * frequency * shaper.delays_s)
    cosine, sine = np.sum(grown * np.cos(damped * shaper.delays_s)), np.sum(grown * np.sin(damped * shaper.delays_s))
    return np.exp(-damping * frequency * shaper.delays_s[-1]) * np.hypot(cosine, sine)


@given(frequency=st.floats(0.5, 200.0), damping=st.floats(0.0, 0.3))
@settings(max_examples=examples(50), deadline=None)
def test_zv_and_zvd_leave_nothing_and_move_all_the_way(frequency: float, damping: float) -> None:
    for make in (zv, zvd):
        shaper = make(frequency, damping)
        assert residual_vibration(shaper, frequency, damping) < 1e-12
        assert shaper.gains.sum() == pytest.approx(1.0, abs=1e-14)
        assert (shaper.gains > 0.0).all()


def test_zvd_forgives_a_wrong_frequency_more_than_zv_and_ei_more_than_zvd() -> None:
    wide = {
        make: [abs(s) for s in np.linspace(-0.5, 0.5, 2001) if residual_vibration(make(10.0, 0.0), 10.0 * (1 + s), 0.0) < 0.05]
        for make in (zv, zvd, ei, two_hump_ei)
    }
    insensitivity = [len(shares) / 2000 for shares in wide.values()]
    # 5 % insensitivities of the literature: ZV 0.064, ZVD 0.286, EI 0.398, two-hump EI 0.726
    assert insensitivity == pytest.approx([0.064, 0.286, 0.398, 0.726], abs=0.004)


def test_ei_leaves_5_percent_at_the_modelled_frequency_and_none_beside_it() -> None:
    beside = [residual_vibration(ei(10.0, 0.0), 10.0 * (1 + s), 0.0) for s in np.linspace(-0.2, 0.2, 4001)]
    assert beside[2000] == pytest.approx(0.05, abs=1e-12)
    assert min(beside[:2000]) < 1e-4
    assert min(beside[2001:]) < 1e-4


def test_a_convolution_has_the_zeros_of_both() -> None:
    modes = [(52.6, 0.055), (88.3, 0.0124)]
    shaper = multi_mode(zv, modes)
    assert len(shaper.gains) == 4
    for mode in modes:
        assert residual_vibration(shaper, *mode) < 1e-12


def test_taps_that_fall_together_are_joined() -> None:
    assert len(zv(10.0, 0.0).then(zv(10.0, 0.0)).gains) == 3


def test_moved_onto_samples_the_zeros_stay_exact() -> None:
    frequency, damping = 2 * np.pi * 8.37, 0.0554
    shaper = zv(frequency, damping)
    poles = [complex(-damping * frequency, frequency * np.sqrt(1 - damping**2))]
    conditions = [Condition(0.0, 1.0), *cancelling(poles)]
    rounded = DelayFilter(np.round(shaper.delays_s * 256.0) / 256.0, shaper.gains)
    moved = on_samples(shaper, conditions, 1.0 / 256.0)
    assert np.abs(moved.delays_s * 256.0 - np.round(moved.delays_s * 256.0)).max() < 1e-9
    assert np.abs(residuals(conditions, moved)).max() < 1e-12
    assert residual_vibration(rounded, frequency, damping) > 0.01  # rounding alone leaves this much
    assert moved.transient_s - shaper.transient_s < 2.0 / 256.0


@pytest.mark.parametrize(("frequency", "damping"), [(0.0, 0.1), (10.0, 1.0), (10.0, -0.1), (float("nan"), 0.1)])
def test_a_mode_that_is_none_is_refused(frequency: float, damping: float) -> None:
    with pytest.raises(DesignError, match="positive frequency, damping 0 to below 1"):
        zv(frequency, damping)


def test_the_residual_of_a_simulated_step_is_what_the_formula_says() -> None:
    frequency, damping = 10.0, 0.05
    plant = Dynamics.from_modes([(frequency, damping, 1.0)])
    shaper = zvd(1.1 * frequency, damping)
    mode = plant.modes[0]
    assert float(np.abs(shaper.ending(np.array(mode.pole)))) == pytest.approx(residual_vibration(shaper, frequency, damping), rel=1e-9)
