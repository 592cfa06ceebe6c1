"""A viscous friction is a number of the machine file that stands for a law, and errs by more than a number does."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging.errors_of_laws import ERRS_AS_A_LAW, Removing, share_of_numbers, temperature_of
from hil.diagnosis.judging.form_error import form_error
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.ranking import naming
from hil.diagnosis.ranking.naming import Evidence, Weighed, ranking
from hil.diagnosis.recorded.align import aligned
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.searching.surplus import needs_all
from hil.diagnosis.searching.ways import in_order
from hil.diagnosis.starting.candidates import Candidate, setting_of
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import retune

ENTRIES, REMOVED = 17940.0, 993_000.0
VISCOUS, CONSTANT = EffectAt("viscous_friction", "cart"), EffectAt("torque_constant", "cart")


def weighed(name: str, gained: float, parameters: int, by_numbers: float = 0.0) -> Weighed:
    """One that leaves 100 above noise less what it gains over REMOVED, every parameter known to a thousandth."""
    left = ENTRIES + REMOVED - gained
    fitted = Fitted((EffectAt(name, "cart"),), (np.ones(parameters),), np.zeros(0), np.zeros(1), left, (), np.zeros((1, 0)), np.zeros(0))
    return Weighed(fitted, left, 0.0, (1e6,) * parameters, by_numbers=(by_numbers, 0.0), of_the_file=by_numbers > 0.0)


def shares(known: EffectAt, more: float) -> tuple[float, float]:
    """Of a number of the file, and of a law that holds it as a part and gains so much more."""
    number = weighed(known.effect, REMOVED - 100.0 - more, 1, share_of_numbers((known,)) * REMOVED)
    law = weighed("asymmetric_friction", REMOVED - 100.0, 4)
    evidence = Evidence((number, law), Weighed(None, ENTRIES + REMOVED, 0.0), ENTRIES, 0.0, 30, True)
    found = {h.fitted.effects[0].effect: h.share for h in ranking(evidence) if h.fitted is not None}
    return found[known.effect], found["asymmetric_friction"]


def test_what_a_viscous_friction_s_own_error_may_be_names_no_asymmetric_one():
    """5.5e-4 of its energy, as of one with 16 % less friction at the highest speed, where levels and slopes are equal both ways."""
    viscous, asymmetric = shares(VISCOUS, 5.5e-4 * REMOVED)
    assert viscous > 0.7 > 0.3 > asymmetric
    viscous, asymmetric = shares(VISCOUS, 0.01 * REMOVED)
    assert asymmetric > 0.9 > 0.1 > viscous


def test_a_number_that_stands_for_no_law_errs_by_a_hundredth_of_that():
    constant, asymmetric = shares(CONSTANT, 5.5e-4 * REMOVED)
    assert asymmetric > 0.9 > 0.1 > constant


@pytest.mark.parametrize(("known", "errs"), [((CONSTANT,), 1e-5), ((VISCOUS,), 2.08e-4), ((VISCOUS, CONSTANT), 2.08e-4)])
def test_the_temper_beside_a_number_is_what_it_errs_by(known, errs):
    by_numbers = share_of_numbers(known) * REMOVED
    found = temperature_of([Removing(ENTRIES, by_numbers)], ENTRIES + REMOVED, ENTRIES)
    assert found - 1.0 == pytest.approx(errs * REMOVED, rel=0.03)


def test_where_another_set_is_closest_in_one_motion_the_best_one_s_numbers_count_for_exactness_there(monkeypatch):
    """A gear's ratio leaves a little more held out than a lag, which leaves much more in training: its equation is exact all the same."""
    seen: list[tuple[float, ...]] = []

    def exactness(parts, *weights):
        seen.append(tuple(part.by_numbers for part in parts))
        return 0.5

    monkeypatch.setattr(naming, "exactness", exactness)
    base = Weighed(None, ENTRIES + 1e6, ENTRIES + 5e5)
    ratio = Weighed(None, ENTRIES + 10.0, ENTRIES + 60.0, (1e6,), by_numbers=(999_990.0, 499_940.0), of_the_file=False)
    lag = Weighed(None, ENTRIES + 300.0, ENTRIES + 20.0, (1e6,))
    naming.weighed([ratio, lag], base, (ENTRIES, ENTRIES), 30)
    assert seen == [(999_990.0, 499_940.0)]


def test_what_another_number_removed_before_errs_no_more_for_a_viscous_friction_beside_it():
    """A torque constant removed a billion; beside it a viscous friction of a million with seven searched numbers more leaves a million less
    than a load. A hundred thousandth of the billion may err, not a ten thousandth.
    """
    noise, before = ENTRIES, 1e9

    def fitted(cost: float, parameters: int, *effects: EffectAt) -> Fitted:
        values = (np.ones(1),) * (len(effects) - 1) + (np.ones(parameters),)
        return Fitted(effects, values, np.zeros(0), np.zeros(1), cost, (), np.zeros((1, 0)), np.full(parameters, 1e8))

    gate = SimpleNamespace(gain=before)
    stand = SimpleNamespace(effects=(CONSTANT,), gates=(gate,), fitted=fitted(noise + 1e6, 1, CONSTANT), cost=noise + 1e6)
    load = fitted(noise + 1e6 - 1.0, 1, CONSTANT, EffectAt("constant_load", "cart"))
    close = fitted(noise, 8, CONSTANT, VISCOUS)
    tried = Tried([Candidate(effect, ()) for effect in (CONSTANT, VISCOUS, load.effects[1])])
    assert in_order([load, close], before + noise + 1e6, noise, tried, stand)[0] is close


@pytest.mark.parametrize(("known", "enough"), [(VISCOUS, False), (CONSTANT, True)])
def test_a_pair_must_gain_more_over_a_viscous_friction_than_over_another_number(known, enough):
    """2000 beside one that removed a million: ten times what chance and 1e-5 of that allow, half of what a law's error does."""
    mode = EffectAt("structural_mode", "cart")

    def fitted(cost: float, *effects: EffectAt) -> Fitted:
        nothing = np.zeros(1), np.zeros(0), cost, tuple((k, 0) for k in range(len(effects))), np.zeros((0, 0)), np.zeros(0)
        return Fitted(effects, (np.ones(1),) * len(effects), *nothing)

    single, pair = fitted(ENTRIES + 2000.0, known), fitted(ENTRIES, known, mode)
    tried = Tried([Candidate(effect, ()) for effect in (known, mode)])
    stand = SimpleNamespace(effects=())
    assert needs_all(pair, stand, [single], ENTRIES + 1e6, tried, int(ENTRIES)) is enough


def test_a_viscous_friction_s_error_functions_have_a_fiftieth_of_the_energy_of_another_law_s(monkeypatch):
    found = mismatch(MACHINE, aligned(MACHINE, repeats(3, duration_s=2.0)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        tuning = retune(runs)
        effect, values = EffectAt("viscous_friction", MACHINE.axes[0]), np.array([20.0])
        predicted = runs.run_one(Trial(tuning.values, (setting_of(effect, values),)))
        one = Fitted((effect,), (values,), tuning.offset, predicted, 0.0, (), np.zeros((len(predicted), 0)), np.zeros(0))
        own = form_error(runs, TRAIN, tuning, one).responses
        monkeypatch.setitem(ERRS_AS_A_LAW, effect.effect, 1.0)
        another_law_s = form_error(runs, TRAIN, tuning, one).responses
    assert len(own) > 5
    assert np.sum(own**2) == pytest.approx(0.02 * np.sum(another_law_s**2))
