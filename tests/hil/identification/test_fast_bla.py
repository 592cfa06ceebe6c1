"""Claims of the fast best linear approximation: one realisation, detection lines."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, Loop, experiment, plant_response, two_mode_loop

from hil.identification import IdentificationError, PeriodicRecords, fast_bla, periodic_records, robust_bla

PERIOD, SETTLE = 512, 4
ODD = np.arange(1, 120, 2)
STEEP = 18  # lines below the first resonance
QUIET, NOISE = (1e-5, 1e-6, 1e-6), (0.1, 0.01, 0.01)


def with_detection(rng: np.random.Generator, lines: np.ndarray, group: int) -> np.ndarray:
    """Leave one line out of every group of consecutive ones, at random."""
    groups = [lines[i : i + group] for i in range(0, len(lines) - group + 1, group)]
    return np.setdiff1d(lines, [rng.choice(each) for each in groups])


def records_of(
    rng: np.random.Generator, loop: Loop, lines: np.ndarray, noise: tuple[float, float, float], realisations: int = 1, periods: int = 4
) -> PeriodicRecords:
    data = experiment(loop, rng, realisations=realisations, periods=periods, settle_periods=SETTLE, period=PERIOD, lines=lines, noise=noise)
    return periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, settle_periods=SETTLE)


@pytest.mark.parametrize("group", [2, 3, 4])
def test_on_a_linear_plant_total_and_noise_variance_agree_and_bounds_hold(group: int) -> None:
    rng = np.random.default_rng(group)
    loop = two_mode_loop(damping=(0.1, 0.1))
    lines = with_detection(rng, ODD, group)
    truth = plant_response(loop, lines * SAMPLE_RATE_HZ / PERIOD)
    inside, ratios = {"noise": [], "total": []}, []
    for _ in range(25):
        response = fast_bla(records_of(rng, loop, lines, NOISE))
        for kind, found in inside.items():
            found.append(np.abs(response.G - truth) <= response.bound(0.95, kind))
        ratios.append(response.standard_deviation("total") ** 2 / response.standard_deviation("noise") ** 2)
    assert np.mean(inside["noise"]) == pytest.approx(0.95, abs=0.02)
    assert np.mean(inside["total"]) == pytest.approx(0.95, abs=0.02)
    assert np.mean(ratios) == pytest.approx(6 / 5, rel=0.1)  # the mean of F with 6 degrees of freedom in the noise


def test_nonlinear_variance_is_the_scatter_between_realisations() -> None:
    """The detection lines of a single realisation tell how estimates from other realisations would differ.

    Above the first lines, that is: there the distortion of a cubic spring falls steeply and linear interpolation overstates it.
    """
    rng = np.random.default_rng(7)
    loop = two_mode_loop(damping=(0.1, 0.1), cubic=3e-4, feedback=2.0)
    lines = with_detection(rng, ODD, 3)
    made = [fast_bla(records_of(rng, loop, lines, QUIET)) for _ in range(30)]
    scatter = np.var(np.stack([response.G for response in made]), axis=0, ddof=1)
    reported = np.mean([response.standard_deviation("nonlinear") ** 2 for response in made], axis=0)
    assert np.exp(np.mean(np.log(reported / scatter)[STEEP:])) == pytest.approx(1.0, abs=0.35)
    assert np.median(scatter / np.mean([response.standard_deviation("noise") ** 2 for response in made], axis=0)) > 100


def test_it_finds_the_nonlinear_variance_the_robust_method_finds() -> None:
    rng = np.random.default_rng(8)
    loop = two_mode_loop(damping=(0.1, 0.1), cubic=3e-4)
    lines = with_detection(rng, ODD, 3)
    robust = robust_bla(records_of(rng, loop, lines, QUIET, realisations=12))
    fast = [fast_bla(records_of(rng, loop, lines, QUIET)) for _ in range(12)]
    ratio = np.mean([f.standard_deviation("nonlinear") ** 2 for f in fast], axis=0) / robust.standard_deviation("nonlinear") ** 2
    assert np.exp(np.mean(np.log(ratio[STEEP:]))) == pytest.approx(1.0, abs=0.4)


def test_even_detection_lines_do_not_count_towards_an_odd_excitation() -> None:
    rng = np.random.default_rng(9)
    loop = two_mode_loop(damping=(0.1, 0.1), square=1e-4)
    response = fast_bla(records_of(rng, loop, with_detection(rng, ODD, 3), QUIET))
    assert np.median(response.standard_deviation("total") / response.standard_deviation("noise")) < 3.0
    assert response.even_odd.level[response.even_odd.even].mean() > 100 * response.even_odd.noise.mean()


def test_without_detection_lines_it_says_what_it_needs() -> None:
    rng = np.random.default_rng(10)
    with pytest.raises(IdentificationError, match="needs detection lines, 1 in 2, 3 or 4 left out"):
        fast_bla(records_of(rng, two_mode_loop(damping=(0.1, 0.1)), np.arange(1, 100), NOISE))


def test_several_realisations_are_for_the_robust_method() -> None:
    rng = np.random.default_rng(10)
    with pytest.raises(IdentificationError, match="takes one realisation, not 2"):
        fast_bla(records_of(rng, two_mode_loop(damping=(0.1, 0.1)), with_detection(rng, ODD, 3), NOISE, realisations=2))
