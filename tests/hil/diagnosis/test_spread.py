"""How far parameters may be off, against drawn recordings, and intervals of several sets, against drawn parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE

from hil.diagnosis.answering.estimates import Believed, believed, effect_estimates, interval
from hil.diagnosis.answering.spread import TWO_SIDED_95, as_normal, spread, spread_of
from hil.diagnosis.fitting.refit import Fitted, refit
from hil.diagnosis.ranking.naming import Weighed
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import setting_of
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import PRIOR, retune

ENTRIES, DRAWS, CERTAIN = 80, 4000, 1e9


def white(_functional: np.ndarray) -> float:
    return 1.0


def fitted_to_drawn(columns: np.ndarray, known: np.ndarray, random: np.random.Generator, variance: float = 1.0) -> np.ndarray:
    """(DRAWS, K) of least squares with a prior around zero, less the truth that was drawn from it."""
    truth = random.standard_normal((DRAWS, len(known))) / np.sqrt(known)
    measured = truth @ columns.T + np.sqrt(variance) * random.standard_normal((DRAWS, len(columns)))
    return np.linalg.solve(columns.T @ columns + np.diag(known), columns.T @ measured.T).T - truth


def test_spreads_are_those_of_fits_to_drawn_recordings():
    random = np.random.default_rng(1)
    columns = random.standard_normal((ENTRIES, 4)) * [3.0, 0.05, 0.02, 1.0]
    columns[:, 3] = columns[:, 0] + 0.1 * columns[:, 3]
    known = np.array([1.0, 1.0, 4.0, 0.01])
    errors = fitted_to_drawn(columns, known, random)
    assert spread(columns, known, white, CERTAIN) == pytest.approx(errors.std(axis=0), rel=0.05)


def test_noise_that_is_stronger_than_the_model_says_widens_its_own_part_alone():
    random = np.random.default_rng(2)
    columns, known = random.standard_normal((ENTRIES, 3)) * [3.0, 0.1, 0.001], np.ones(3)
    errors = fitted_to_drawn(columns, known, random, 9.0)
    found = spread(columns, known, lambda _: 9.0, CERTAIN)
    assert found == pytest.approx(errors.std(axis=0), rel=0.05)
    quiet = spread(columns, known, white, CERTAIN)
    assert found[[0, 2]] / quiet[[0, 2]] == pytest.approx([3.0, 1.0], rel=0.01)


@pytest.mark.parametrize("freedom", [4.2, 6.2, 30.0])
def test_a_variance_that_is_not_known_widens_intervals_as_it_must(freedom):
    """Strengths drawn with a variance that was drawn itself: the expected variance, widened, holds 95 % of them."""
    random = np.random.default_rng(3)
    variance = freedom / random.chisquare(freedom, 400_000)
    strengths = np.sqrt(variance) * random.standard_normal(len(variance))
    expected = freedom / (freedom - 2.0)
    reach = TWO_SIDED_95 * as_normal(freedom) * np.sqrt(expected)
    assert np.mean(np.abs(strengths) < reach) == pytest.approx(0.95, abs=0.002)
    assert TWO_SIDED_95 * spread(np.ones((1, 1)), np.zeros(1), lambda _: expected, freedom) == pytest.approx(reach)


@pytest.mark.parametrize("strength", [1.0, 1e9])
def test_what_recordings_do_not_tell_apart_may_be_anything_beforehand(strength):
    """Scale and bias of a sensor that reads a constant: their sum shows, neither of them does, however little noise there is; a third
    parameter is not touched.
    """
    random = np.random.default_rng(4)
    constant, other = np.full(ENTRIES, 6.0 * strength), random.standard_normal(ENTRIES)
    known = 12.0 / np.array([0.4, 10.0, 1.0]) ** 2
    found = spread(np.column_stack([6.0 * constant, constant, other]), known, white, CERTAIN)
    scale, bias = 0.4 / np.sqrt(12.0), 10.0 / np.sqrt(12.0)
    left = scale * bias / np.hypot(6.0 * scale, bias)  # of a scale whose effect a bias takes back
    assert found[0] == pytest.approx(left, rel=1e-3)
    assert found[1] == pytest.approx(6.0 * left, rel=1e-3)
    assert found[2] == pytest.approx(1.0 / np.hypot(np.linalg.norm(other - other.mean()), np.sqrt(12.0)), rel=0.01)


def test_what_recordings_do_not_show_at_all_may_be_anything_beforehand():
    assert spread(np.zeros((ENTRIES, 1)), np.array([12.0 / 10.0**2]), white, CERTAIN) == pytest.approx(10.0 / np.sqrt(12.0))


def test_a_place_that_recordings_do_not_show_may_be_where_they_go(with_friction):
    found = mismatch(MACHINE, with_friction[0])
    stop, values = EffectAt("end_stop", "carriage"), np.array([0.0, 0.0, 0.01, 1.0])
    travel = np.ptp(np.concatenate([group.position for group in found.groups]))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning = retune(runs)
        fitted = Fitted((stop,), (values,), tuning.offset, tuning.predicted, 0.0, ((0, 0), (0, 1), (0, 2)), np.zeros((1, 3)), np.zeros(3))
        (*_, place) = spread_of(runs, tuning, fitted)
    assert place == pytest.approx(travel / np.sqrt(12.0))


def test_a_machine_that_shows_none_of_its_numbers_has_none_to_give_an_interval():
    assert spread(np.zeros((ENTRIES, 0)), np.zeros(0), white, CERTAIN).shape == (0,)


def test_a_friction_is_known_no_better_than_the_force_it_is_measured_by(with_friction):
    """Mass, damping, drive constant and friction scaled alike change no recording; each of the three is known to a tenth."""
    found = mismatch(MACHINE, with_friction[0])
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning = retune(runs)
        (fitted,) = refit(runs, tuning, runs.measured(), [((EffectAt("coulomb_friction", "carriage"),), (np.array([10.0]),))])
        (*_, own) = spread_of(runs, tuning, fitted)
    assert own / fitted.values[0][0] == pytest.approx(PRIOR / np.sqrt(3.0), rel=0.1)


def test_a_frequency_s_spread_does_not_depend_on_how_far_differences_are_taken(with_friction, monkeypatch):
    """Its phase at the end of the record is off by radians at the first difference."""
    found = mismatch(MACHINE, with_friction[0])
    shaken, values = EffectAt("base_motion", "carriage"), np.array([300.0, 40.0, 0.3])
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning = retune(runs)
        predicted = runs.run_one(Trial(tuning.values, (setting_of(shaken, values),)))
        none = np.zeros((len(predicted), 3))
        fitted = Fitted((shaken,), (values,), tuning.offset, predicted, 0.0, ((0, 0), (0, 1), (0, 2)), none, np.zeros(3))
        found = spread_of(runs, tuning, fitted)
        monkeypatch.setattr("hil.diagnosis.answering.spread.FINE_SHARE", 1e-5)
        nearer = spread_of(runs, tuning, fitted)
    assert found[-3:] == pytest.approx(nearer[-3:], rel=0.01)


def test_one_set_s_interval_is_its_own():
    assert interval([(0.3, 5.0, 2.0)]) == pytest.approx((5.0 - 1.96 * 2.0, 5.0 + 1.96 * 2.0), rel=1e-4)
    assert interval([(0.3, 5.0, 0.0)]) == (5.0, 5.0)


def test_an_interval_of_several_sets_holds_95_percent_of_what_they_say_together():
    parts = [(0.3, 5.0, 0.1), (0.15, 4.0, 0.3), (0.05, 8.0, 0.2)]
    random = np.random.default_rng(5)
    which = random.choice(3, 400_000, p=np.array([0.6, 0.3, 0.1]))
    drawn = np.array([mean for _, mean, _ in parts])[which] + np.array([s for *_, s in parts])[which] * random.standard_normal(len(which))
    low, high = interval(parts)
    assert np.mean((drawn > low) & (drawn < high)) == pytest.approx(0.95, abs=0.002)
    assert low == pytest.approx(np.quantile(drawn, 0.025), abs=0.01)
    assert high == pytest.approx(np.quantile(drawn, 0.975), abs=0.01)


def test_a_parameter_s_interval_is_that_of_all_plausible_sets_with_its_effect(with_friction):
    """A set with the friction beside the likeliest, one without it, and one that only counts beside little else."""
    found = mismatch(MACHINE, with_friction[0])
    friction, load = EffectAt("coulomb_friction", "carriage"), EffectAt("constant_load", "carriage")
    starts = [((friction,), (np.array([10.0]),)), ((load, friction), (np.array([0.1]), np.array([10.0]))), ((load,), (np.array([0.1]),))]
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning = retune(runs)
        alone, both, without = (fit for fit in refit(runs, tuning, runs.measured(), starts) if fit is not None)
        both = replace(both, values=(both.values[0], 1.5 * alone.values[0]))
        sets = [Weighed(fit, 0.0, 0.0, (), share) for fit, share in ((alone, 0.3), (both, 0.1), (without, 0.1), (both, 0.01))]
        first, second = believed(runs, tuning, sets, spread_of(runs, tuning, alone))
        with_little = [Weighed(fit, 0.0, 0.0, (), share) for fit, share in ((alone, 0.3), (both, 0.03))]  # the first has less than 95 %
        assert [one.confidence for one in believed(runs, tuning, with_little, spread_of(runs, tuning, alone))] == [0.3, 0.03]
    (own,), (mixed,) = effect_estimates(MACHINE.plant, [first]), effect_estimates(MACHINE.plant, [first, second])
    value = float(alone.values[0][0])
    assert (first.confidence, second.confidence) == (0.3, 0.1)
    assert own["Fc"].ci95 == pytest.approx((value - 1.96 * first.spread[0], value + 1.96 * first.spread[0]), rel=1e-4)
    parts = [(0.3, value, float(first.spread[0])), (0.1, 1.5 * value, float(second.spread[1]))]
    assert mixed["Fc"].ci95 == pytest.approx(interval(parts))
    assert mixed["Fc"].value == value
    assert mixed["Fc"].ci95[1] > 1.5 * value


def test_of_two_coggings_at_a_place_the_same_order_s_intervals_are_mixed():
    """A plausible set found them in the other sequence, another one has but one of them."""
    first, second = EffectAt("cogging", "carriage"), EffectAt("cogging", "carriage", 2)

    def held(share: float, effects: tuple[EffectAt, ...], *orders: float) -> Believed:
        values = tuple(np.array([order, 0.1, 0.0, 0.0, 0.0]) for order in orders)
        free = tuple((k, 0) for k in range(len(orders)))
        nothing = np.zeros((0, len(orders)))
        return Believed(
            Fitted(effects, values, np.zeros(0), np.zeros(0), 0.0, free, nothing, np.zeros(0)), share, 0.01 * np.ones(len(orders))
        )

    sets = [held(0.4, (first, second), 12.0, 31.0), held(0.3, (first, second), 31.1, 12.0), held(0.1, (first,), 31.0)]
    low, high = (table["Np"].ci95 for table in effect_estimates(MACHINE.plant, sets))
    assert low == pytest.approx(interval([(0.4, 12.0, 0.01), (0.3, 12.0, 0.01)]))
    assert high == pytest.approx(interval([(0.4, 31.0, 0.01), (0.3, 31.1, 0.01), (0.1, 31.0, 0.01)]))
