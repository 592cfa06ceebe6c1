"""Numbers of the machine file beyond re-tuning's bounds are fitted beside what is mistaken for them, whatever their screening says."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis import numbers_of_the_file
from hil.diagnosis.numbers_of_the_file import are_neighbours, with_numbers_of_the_file
from hil.diagnosis.refit import Fitted
from hil.diagnosis.result import EffectAt
from hil.diagnosis.screening import Screened

HARDENING, COMPLIANCE, GAP, ELSEWHERE = (
    EffectAt(name, at)
    for name, at in (
        ("nonlinear_stiffness", "propeller"),
        ("joint_compliance", "propeller"),
        ("backlash", "propeller"),
        ("joint_compliance", "roll"),
    )
)
BEFORE = 1000.0


def fitted(effect: EffectAt, cost: float) -> Fitted:
    return Fitted((effect,), (np.ones(1),), np.zeros(0), np.zeros(0), cost, ((0, 0),), np.zeros((0, 1)), np.ones(1))


@pytest.mark.parametrize(("comes_to", "kept"), [(90.0, True), (600.0, False)])
def test_a_number_that_scored_nothing_is_fitted_in_place_of_what_is_mistaken_for_it(monkeypatch, comes_to, kept):
    """Neither what is elsewhere nor what is no number of the file: their screening tells."""
    screened = [Screened(effect, np.ones(1), np.zeros(1), score) for effect, score in ((GAP, 5.0), (ELSEWHERE, 1.0), (COMPLIANCE, 0.0))]
    asked = []

    def refit(runs, tuning, measured, starts):
        asked.extend(effects for effects, _ in starts)
        return [fitted(effects[0], comes_to) for effects, _ in starts]

    monkeypatch.setattr(numbers_of_the_file, "refit", refit)
    monkeypatch.setattr(numbers_of_the_file, "polish", lambda runs, tuning, measured, fits: list(fits))
    found = with_numbers_of_the_file(None, None, np.zeros(0), [fitted(HARDENING, 100.0)], screened, BEFORE)
    assert asked == [(COMPLIANCE,)]
    assert ((COMPLIANCE,) in [fit.effects for fit in found]) is kept


def test_what_was_fitted_is_not_fitted_again():
    """Nor is anything asked of the simulation: there are no free runs here."""
    fits = [fitted(HARDENING, 100.0), fitted(COMPLIANCE, 90.0)]
    screened = [Screened(COMPLIANCE, np.ones(1), np.zeros(1), 0.0)]
    assert with_numbers_of_the_file(None, None, np.zeros(0), fits, screened, BEFORE) == fits


def test_either_of_two_effects_may_name_the_other_as_its_neighbour():
    assert are_neighbours(COMPLIANCE, HARDENING) and are_neighbours(HARDENING, COMPLIANCE)
    assert not are_neighbours(ELSEWHERE, HARDENING)
