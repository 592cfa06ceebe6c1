"""A set of which an effect was fitted to nothing is the set without it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import what_acts
from hil.diagnosis.searching.what_acts import acts, with_what_acts

SIGN, QUADRATIC, VISCOUS, LIMIT = (
    EffectAt(name, "arm") for name in ("rectified_sensor", "quadratic_friction", "viscous_friction", "current_saturation")
)


def fitted(cost: float, *each: tuple[EffectAt, list[float]]) -> Fitted:
    effects, values = tuple(effect for effect, _ in each), tuple(np.array(some) for _, some in each)
    return Fitted(effects, values, np.zeros(1), np.zeros(4), cost, (), np.zeros((4, 0)), np.zeros(0))


@pytest.fixture
def sets_fitted_on(monkeypatch):
    """Every set that is fitted on; it comes to the cost 7."""
    begun: list[Fitted] = []

    def polish(runs, tuning, measured, fits):
        begun.extend(fits)
        return [replace(fit, cost=7.0) for fit in fits]

    monkeypatch.setattr(what_acts, "polish", polish)
    return begun


def without_idle(*fits: Fitted, stand: tuple[EffectAt, ...] = (), may_stand=lambda fit: True) -> list[Fitted]:
    return with_what_acts(SimpleNamespace(), SimpleNamespace(), np.zeros(4), fits, stand, may_stand)


def test_what_stood_for_another_is_left_out_beside_it(sets_fitted_on):
    three = fitted(7.5, (SIGN, [1.0, 1.0]), (QUADRATIC, [0.0]), (VISCOUS, [2.0]))
    (two,) = without_idle(three, stand=(SIGN, QUADRATIC))
    assert two.effects == (SIGN, VISCOUS) and [values.tolist() for values in two.values] == [[1.0, 1.0], [2.0]] and two.cost == 7.0
    assert [fit.effects for fit in sets_fitted_on] == [(SIGN, VISCOUS)]


@pytest.mark.parametrize(
    ("last", "others", "stand"),
    [([2.0], (), ()), ([0.0], (), (QUADRATIC,)), ([0.0], ((QUADRATIC, [1.0]),), ())],
    ids=["both act", "what is left is what was there", "the smaller set was fitted"],
)
def test_other_sets_stay_as_they_are(sets_fitted_on, last, others, stand):
    fits = [fitted(7.5, (QUADRATIC, [1.0]), (VISCOUS, last)), *(fitted(8.0, one) for one in others)]
    assert without_idle(*fits, stand=stand) == fits and not sets_fitted_on


def test_what_comes_to_nothing_beside_two_does_not_take_the_place_of_both(sets_fitted_on):
    """One of the two would be judged against nothing, pass and stand for both."""
    three = fitted(7.5, (SIGN, [1.0, 1.0]), (QUADRATIC, [0.0]), (VISCOUS, [0.0]))
    assert without_idle(three, stand=(SIGN, QUADRATIC)) == [three] and not sets_fitted_on


def test_a_smaller_set_that_may_not_stand_takes_no_place(sets_fitted_on):
    three = fitted(7.5, (SIGN, [1.0, 1.0]), (QUADRATIC, [0.0]), (VISCOUS, [2.0]))
    assert without_idle(three, stand=(SIGN, QUADRATIC), may_stand=lambda fit: fit.cost > 7.0) == [three]
    assert [fit.effects for fit in sets_fitted_on] == [(SIGN, VISCOUS)]


def test_a_limit_acts_whatever_its_number_is():
    assert acts(LIMIT, np.array([3.0, 0.0])) and acts(VISCOUS, np.array([1e-9])) and not acts(VISCOUS, np.zeros(1))
