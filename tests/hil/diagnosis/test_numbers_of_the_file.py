"""Numbers of the machine file beyond re-tuning's bounds are fitted beside what is mistaken for them, whatever their screening says."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.fitting.screening import Screened
from hil.diagnosis.judging.judgement import Stand
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching import numbers_of_the_file
from hil.diagnosis.searching.numbers_of_the_file import are_neighbours, with_numbers_of_the_file
from hil.machine import load_machine

HARDENING, COMPLIANCE, GAP, ELSEWHERE = (
    EffectAt(name, at)
    for name, at in (
        ("nonlinear_stiffness", "propeller"),
        ("joint_compliance", "propeller"),
        ("backlash", "propeller"),
        ("joint_compliance", "roll"),
    )
)
RUNS = SimpleNamespace(machine=load_machine("carm"))
BEFORE = 1000.0
ENTRIES = 100
SIGN = EffectAt("rectified_sensor", "gyro_y")


def fitted(cost: float, *effects: EffectAt) -> Fitted:
    ones = (np.ones(1),) * len(effects)
    return Fitted(effects, ones, np.zeros(0), np.zeros(0), cost, ((0, 0),), np.zeros((0, 1)), np.ones(1))


def stand(*found: EffectAt) -> Stand:
    return Stand(fitted(BEFORE, *found) if found else None, None, BEFORE, np.zeros(0), None, ())


@pytest.mark.parametrize(("comes_to", "kept"), [(90.0, True), (600.0, False)])
@pytest.mark.parametrize("found_before", [(), (SIGN,)], ids=["alone", "beside another"])
def test_a_number_that_scored_nothing_is_fitted_in_place_of_what_is_mistaken_for_it(monkeypatch, found_before, comes_to, kept):
    """Neither what is elsewhere nor what is no number of the file: their screening tells."""
    screened = [Screened(effect, np.ones(1), np.zeros(1), score) for effect, score in ((GAP, 5.0), (ELSEWHERE, 1.0), (COMPLIANCE, 0.0))]
    asked = []

    def refit(runs, tuning, measured, starts):
        asked.extend(effects for effects, _ in starts)
        return [fitted(comes_to, *effects) for effects, _ in starts]

    monkeypatch.setattr(numbers_of_the_file, "refit", refit)
    monkeypatch.setattr(numbers_of_the_file, "polish", lambda runs, tuning, measured, fits: list(fits))
    fits = [fitted(100.0, *found_before, HARDENING)]
    found = with_numbers_of_the_file(RUNS, None, np.zeros(ENTRIES), fits, screened, stand(*found_before))
    wanted = (*found_before, COMPLIANCE)
    assert asked == [wanted]
    assert (wanted in [fit.effects for fit in found]) is kept


def test_what_was_fitted_is_not_fitted_again():
    """Nor is anything asked of the simulation: there are no free runs here."""
    fits = [fitted(100.0, HARDENING), fitted(90.0, COMPLIANCE)]
    screened = [Screened(COMPLIANCE, np.ones(1), np.zeros(1), 0.0)]
    assert with_numbers_of_the_file(RUNS, None, np.zeros(ENTRIES), fits, screened, stand()) == fits


def test_where_much_is_left_any_number_at_that_place_is_fitted(monkeypatch):
    asked = []
    monkeypatch.setattr(numbers_of_the_file, "refit", lambda runs, tuning, measured, starts: asked.extend(e for e, _ in starts) or [])
    monkeypatch.setattr(numbers_of_the_file, "polish", lambda runs, tuning, measured, fits: list(fits))
    gain = EffectAt("torque_constant", "propeller")
    screened = [Screened(effect, np.ones(1), np.zeros(1), 0.0) for effect in (ELSEWHERE, gain, EffectAt("rectified_sensor", "gyro_y"))]
    for cost, wanted in ((float(ENTRIES), []), (3.0 * ENTRIES, [(gain,)])):
        with_numbers_of_the_file(RUNS, None, np.zeros(ENTRIES), [fitted(cost, HARDENING)], screened, stand())
        assert asked == wanted


def test_either_of_two_effects_may_name_the_other_as_its_neighbour():
    assert are_neighbours(COMPLIANCE, HARDENING) and are_neighbours(HARDENING, COMPLIANCE)
    assert not are_neighbours(ELSEWHERE, HARDENING)
