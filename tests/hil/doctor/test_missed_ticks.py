"""Predictions from times whose distribution is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import genextreme

from hil.bench.timing import LoopTiming
from hil.doctor.examine import predicted
from hil.doctor.tail import HORIZON_S, WINDOWS, extreme_value_distribution, missed_ticks, predict, wandering
from hil.doctor.trial import tick_times

PERIOD_S = 1.0 / 256.0


def exponential(scale_s: float, ticks: int, seed: int) -> np.ndarray:
    """Ticks of half a millisecond with an exponential tail."""
    return 5e-4 + np.random.default_rng(seed).exponential(scale_s, ticks)


def test_a_tick_is_lost_when_a_whole_period_is() -> None:
    assert missed_ticks(PERIOD_S * np.array([0.5, 1.9, 2.1, 3.5, 11.2]), PERIOD_S).tolist() == [0, 0, 1, 2, 10]


def test_percentiles_are_those_of_the_distribution() -> None:
    found = predict(exponential(1e-4, 200_000, 1), PERIOD_S)
    for value, beyond in ((found.p50_s, 0.5), (found.p99_s, 0.01), (found.p999_s, 0.001)):
        assert value == pytest.approx(5e-4 - 1e-4 * np.log(beyond), rel=0.03)


@pytest.mark.parametrize("shape", [-0.3, 0.0, 0.3])
def test_the_fitted_extreme_value_distribution_is_the_one_drawn_from(shape: float) -> None:
    drawn = genextreme.rvs(shape, 2e-3, 3e-4, size=20_000, random_state=4)
    found = extreme_value_distribution(drawn)
    assert found[0] == pytest.approx(shape, abs=0.03)
    assert found[1:] == (pytest.approx(2e-3, rel=0.01), pytest.approx(3e-4, rel=0.03))


def test_the_interval_holds_the_truth_as_often_as_it_says_and_the_extrapolation_is_of_its_size() -> None:
    scale_s = 7.5e-4
    lost = sum(np.exp(-(j * PERIOD_S - 5e-4) / scale_s) for j in range(2, 50)) * 600.0 / PERIOD_S
    found = [predict(exponential(scale_s, 2560, seed), PERIOD_S) for seed in range(100)]
    held = sum(one.least_missed <= lost <= one.most_missed for one in found)
    assert held >= 88
    assert np.median([one.expected_missed for one in found]) == pytest.approx(lost, rel=0.5)


def test_the_interval_of_the_percentile_holds_that_of_a_long_run_whose_stalls_last_some_ticks() -> None:
    long_run = float(np.percentile(stalling(40_000, 0), 99.9))
    found = [predict(stalling(240, seed), PERIOD_S) for seed in range(1, 41)]
    assert sum(one.p999_least_s <= long_run <= one.p999_most_s for one in found) >= 34
    assert all(one.p999_least_s <= one.p999_s <= one.p999_most_s for one in found)
    narrow = np.median([one.p999_most_s / one.p999_least_s for one in found])
    assert narrow < 3.0


def flicker(windows: int, seed: int) -> np.ndarray:
    """A level (16 windows,) with a spectrum of 1/f, drawn in the frequency domain."""
    rng, n = np.random.default_rng(seed), 64 * windows * 16
    spectrum = np.maximum(np.fft.rfftfreq(n), 1.0 / n) ** -0.5
    return np.fft.irfft(spectrum * (rng.standard_normal(len(spectrum)) + 1j * rng.standard_normal(len(spectrum))), n)[: 16 * windows]


@pytest.mark.parametrize("horizon", [1, 10])
def test_the_variance_of_a_wandering_level_is_that_of_drawn_ones(horizon: int) -> None:
    foretold, came = 0.0, 0.0
    for seed in range(1000):
        drawn = flicker(WINDOWS * (1 + horizon), seed).reshape(-1, 16).mean(axis=1)
        foretold += wandering(drawn[:WINDOWS], horizon)
        came += (drawn[WINDOWS:].mean() - drawn[:WINDOWS].mean()) ** 2
    assert foretold == pytest.approx(came, rel=0.15)


def test_the_intervals_hold_what_comes_after_a_trial_though_the_computer_wanders() -> None:
    """Ticks whose tail wanders: 60 s tell of the 600 s after them."""
    trial = 15_360
    p999 = missed = 0
    for seed in range(40):
        level = np.exp(0.15 * flicker(WINDOWS * 11, seed) / np.std(flicker(WINDOWS * 11, seed)))
        scale_s = np.repeat(8e-4 * level, round(HORIZON_S * 1.1 / PERIOD_S) // len(level))
        ticks = 5e-4 + np.random.default_rng(seed).exponential(scale_s)
        one, after = predict(ticks[:trial], PERIOD_S), ticks[trial:]
        p999 += one.p999_least_s <= float(np.percentile(after, 99.9)) <= one.p999_most_s
        lost = int(missed_ticks(after, PERIOD_S).sum()) * HORIZON_S / (len(after) * PERIOD_S)
        missed += one.least_missed <= lost <= one.most_missed
    assert p999 >= 34
    assert missed >= 32


def stalling(blocks: int, seed: int) -> np.ndarray:
    """Quarter seconds of which one in eight has a stall of five ticks."""
    rng = np.random.default_rng(seed)
    ticks = rng.exponential(1e-4, (blocks, 64)) + 5e-4
    ticks[:, :5] += (rng.random(blocks) < 0.125)[:, None] * rng.exponential(1e-3, blocks)[:, None]
    return ticks.ravel()


def test_a_quiet_trial_promises_no_more_than_its_length_can() -> None:
    """Nothing seen in 40 blocks: 90 % two-sided is 1 - 0.05^(1/40) of the blocks (Clopper and Pearson), of 2400 to come by chance more."""
    found = predict(exponential(1e-5, 2560, 0), PERIOD_S)
    assert found.missed_in_trial == 0
    assert found.expected_missed < 1e-6
    assert found.least_missed == 0.0
    assert found.most_missed == pytest.approx(2400.0 * (1.0 - 0.05 ** ((1.0 + 40.0 / 2400.0) / 40.0)), rel=1e-6)
    longer = predict(exponential(1e-5, 25_600, 0), PERIOD_S)
    assert longer.most_missed < 0.12 * found.most_missed


def test_equal_times_are_predicted_to_stay() -> None:
    assert predict(np.full(2560, 1e-3), PERIOD_S).expected_missed == 0.0


def test_too_few_ticks_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 512 are needed"):
        predict(np.zeros(511), PERIOD_S)


def test_on_a_can_bus_its_own_answer_time_takes_the_place_of_the_emulators() -> None:
    one = np.ones(3)
    timing = LoopTiming(3, 0, 0, 1e-5 * one, 9e-4 * one, 6e-4 * one, 1e-4 * one)
    assert tick_times(timing) == pytest.approx(9.1e-4)
    assert tick_times(timing, 8e-4) == pytest.approx(1.11e-3)


@pytest.mark.parametrize(
    ("stall_ticks", "levels"), [([], ["ok", "ok"]), ([3.5], ["ok", "look"]), ([30.5], ["ok", "bad"]), ([3.5] * 30, ["bad", "look"])]
)
def test_what_a_prediction_means_depends_on_the_period_and_on_what_is_bridged(stall_ticks: list[float], levels: list[str]) -> None:
    times = exponential(1e-5, 2560, 0)
    times[100 : 100 + 80 * len(stall_ticks) : 80] = PERIOD_S * np.array(stall_ticks)
    found = list(predicted(predict(times, PERIOD_S), int(missed_ticks(times, PERIOD_S).max()), overrun_ticks=8, suspects=["load"]))
    assert [one.level for one in found] == levels
    assert all("load" in one.advice for one in found if one.level != "ok")
