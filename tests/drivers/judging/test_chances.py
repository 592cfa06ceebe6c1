"""Thresholds keep the chance of a false alarm that they were made for, and are no wider than that."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

from drivers.judging.chances import deviations, packets_until_frozen, share_of


def test_the_chances_of_all_trials_of_an_hour_add_up_to_that_of_the_hour() -> None:
    assert share_of(0.02, 512.0) * 512.0 * 3600.0 == pytest.approx(0.02)


def test_the_number_of_equal_packets_keeps_the_stated_chance() -> None:
    """Coarse readings repeat often: simulated, the share of runs as long as the threshold is below the chance it was made for."""
    chance, resolution, sigma = 1e-3, 0.01, 0.01
    packets = packets_until_frozen(sigma, resolution, chance, 2)
    values = np.round(np.random.default_rng(0).normal(size=2_000_000) * sigma / resolution)
    equal = np.concatenate([[False], values[1:] == values[:-1]])
    runs = np.lib.stride_tricks.sliding_window_view(equal, packets - 1).all(axis=1).mean()
    assert 0.0 < runs < chance


@pytest.mark.parametrize(("sigma", "resolution"), [(0.01, 0.01), (0.005, 0.0006), (0.03, 0.1), (1e-6, 0.0)])
@pytest.mark.parametrize("chance", [1e-3, 1e-9])
def test_one_packet_fewer_would_not_keep_the_chance(sigma: float, resolution: float, chance: float) -> None:
    """By the table of the normal distribution: two readings are equal only if their noise differs by less than a step."""
    step = max(resolution, 2.0**-20)
    equal = 2.0 * NormalDist(0.0, np.sqrt(2.0) * sigma).cdf(step) - 1.0
    packets = packets_until_frozen(sigma, resolution, chance, 2)
    assert equal ** (packets - 1) <= chance
    assert packets == 2 or equal ** (packets - 2) > chance
    assert packets_until_frozen(sigma, resolution, chance, 10_000) == 10_000


@pytest.mark.parametrize(("sigma", "resolution"), [(0.0, 0.01), (-1.0, 0.01), (0.001, 1.0)])
def test_a_still_sensor_whose_noise_does_not_reach_a_step_repeats_itself_and_is_not_judged(sigma: float, resolution: float) -> None:
    assert packets_until_frozen(sigma, resolution, 1e-9, 8) == 0


def test_deviations_of_a_normal_value_are_those_of_a_table() -> None:
    assert deviations(0.05) == pytest.approx(1.95996, abs=1e-5)
    assert deviations(2.0e-9) == pytest.approx(5.9978, abs=1e-3)
