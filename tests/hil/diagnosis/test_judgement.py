"""What a set of effects is judged against, and what its search costs."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats

from hil.diagnosis.fitting.refit import Fitted
from hil.diagnosis.judging import judgement as judging
from hil.diagnosis.judging.errors_of_laws import NUMBERS_ERROR, WEIGHTS, form_variance
from hil.diagnosis.judging.form_error import NO_ERROR, FormError
from hil.diagnosis.judging.gate import HELD_OUT_FREEDOM, HELD_OUT_SCALE, TAIL_FREEDOM
from hil.diagnosis.judging.held_out import Followed
from hil.diagnosis.judging.judgement import Contender, Judgement
from hil.diagnosis.judging.placebos import NO_PLACEBOS
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.retune import Tuning

ENTRIES = 4000
NEITHER = (NO_PLACEBOS, NO_PLACEBOS)
COULOMB, LOAD, VISCOUS = (EffectAt(name, "carriage") for name in ("coulomb_friction", "constant_load", "viscous_friction"))


def tried(count: int = 50, shapes: float = 1.0) -> Tried:
    others = [Candidate(EffectAt("delay", f"axis_{n}"), ()) for n in range(count - 3)]
    return Tried([Candidate(COULOMB, ()), Candidate(LOAD, ()), Candidate(VISCOUS, (), shapes), *others])


def bench(friction: float = 30.0, found: EffectAt = COULOMB, *, apart: bool = False, held_out=None, scattered: float = 0.0, errors=None):
    """A judgement of noise with a friction and a load of 8 in it along directions of their own, and what fits their amplitudes.

    `apart`: the load shows where friction does not. `scattered`: what three repeats differ by along friction. `errors`: the effect along
    whose direction the equation found first may err, by a standard deviation of 6.
    """
    random = np.random.default_rng(2)
    drawn = random.standard_normal((ENTRIES, 3))
    if apart:
        drawn[: ENTRIES // 2, 1] = 0.0
        drawn[ENTRIES // 2 :, (0, 2)] = 0.0
    directions = dict(zip((COULOMB, LOAD, VISCOUS), np.linalg.qr(drawn)[0].T, strict=True))
    noise = random.standard_normal(ENTRIES)
    noise -= sum((noise @ d) * d for d in directions.values())
    measured = noise + friction * directions[found] + 8.0 * directions[LOAD]
    tuning = Tuning((), np.zeros(0, dtype=int), np.ones(0), np.zeros(0), np.zeros(0), np.zeros(ENTRIES), np.zeros((ENTRIES, 0)), np.eye(0))
    repeats = [noise + scattered * a * directions[COULOMB] for a in (1.0, 0.0, -1.0)] if scattered else [noise]
    group = SimpleNamespace(time_s=np.zeros(ENTRIES))
    one, layout = SimpleNamespace(channels=("a",), groups=[group]), SimpleNamespace(size=lambda rows: rows, rate_Hz=10.0)
    sets = {"train": one, "held_out": one}
    runs = SimpleNamespace(measured=lambda: measured, repeats=lambda name: [repeats], sets=sets, noise=layout)

    def equations(name: str, tuning: Tuning, fitted: Fitted) -> FormError:
        along = directions[errors] if name == "train" or not isinstance(held_out, OtherMotion) else held_out.error
        return FormError(6.0 * along[None, :], fitted.effects)

    def fitted(*effects: EffectAt) -> Fitted:
        predicted = sum((measured @ directions[e]) * directions[e] for e in effects)
        cost = float(np.sum((measured - predicted) ** 2))
        free = tuple((e, 0) for e in range(len(effects)))
        return Fitted(
            effects, ((np.ones(1),) * len(effects)), np.zeros(0), predicted, cost, free, np.zeros((ENTRIES, len(effects))), np.ones(1)
        )

    return Judgement(runs, tuning, held_out, float(ENTRIES), None if errors is None else equations), fitted


def judged(before: tuple[EffectAt, ...], *effects: EffectAt, friction: float = 30.0, apart: bool = False) -> Contender:
    judgement, fitted = bench(friction, before[0], apart=apart)
    stand = judgement.nothing
    if before:
        stand = judgement.after(judgement.contenders(stand, [fitted(*before)], tried(), NEITHER, {})[0])
    (found,) = judgement.contenders(stand, [fitted(*effects)], tried(), NEITHER, {})
    return found


def test_an_effect_beside_another_is_judged_by_what_it_adds():
    found = judged((COULOMB,), COULOMB, LOAD)
    assert [gate.gain for gate in found.gates] == pytest.approx([900.0, 64.0])
    assert [gate.is_first for gate in found.gates] == [True, False]
    assert found.gained == pytest.approx(964.0)


def test_what_chance_gains_is_taken_off_every_step_of_a_set():
    """As off the same effects judged at once: else a set that was found step by step would gain more than it."""
    judgement, fitted = bench(30.0, scattered=3.0)
    (first,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})
    (both,) = judgement.contenders(judgement.after(first), [fitted(COULOMB, LOAD)], tried(), NEITHER, {})
    assert first.gate.scatter > 1.5 and first.gained < 890.0
    assert both.gained == pytest.approx(first.gained + both.gate.certain_gain)


def test_a_set_without_the_one_that_was_found_is_judged_against_nothing():
    found = judged((COULOMB, VISCOUS), COULOMB, LOAD)
    assert [gate.gain for gate in found.gates] == pytest.approx([964.0, 964.0])
    assert found.gates[0].is_first
    assert found.passed


def test_beside_a_large_effect_a_gain_must_exceed_what_its_equation_may_err_by():
    beside_little, beside_much = (judged((COULOMB,), COULOMB, LOAD, friction=friction) for friction in (6.0, 60.0))
    assert beside_little.gate.gain == pytest.approx(beside_much.gate.gain)
    assert beside_little.gate.passed
    assert not beside_much.gate.passed


def test_an_equation_errs_only_where_its_effect_acts():
    assert judged((COULOMB,), COULOMB, LOAD, friction=60.0, apart=True).gate.passed


def test_where_it_is_known_how_an_equation_errs_only_that_is_taken_from_a_gain():
    gates = []
    for errors in (VISCOUS, LOAD):
        judgement, fitted = bench(60.0, errors=errors)
        stand = judgement.after(judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})[0])
        (found,) = judgement.contenders(stand, [fitted(COULOMB, LOAD)], tried(), NEITHER, {})
        gates.append(found.gate)
    assert [gate.beyond for gate in gates] == pytest.approx([64.0, 64.0 / 37.0])
    assert [gate.passed for gate in gates] == [True, False]


def test_where_no_errors_of_equations_are_estimated_none_of_a_gain_is_said_to_be_beyond_them():
    found = judged((COULOMB,), COULOMB, LOAD)
    assert [gate.beyond for gate in found.gates] == [None, None]


def test_of_a_number_of_the_machine_file_too_only_its_known_errors_are_taken_from_a_gain():
    judgement, fitted = bench(4000.0, VISCOUS, errors=COULOMB)
    stand = judgement.after(judgement.contenders(judgement.nothing, [fitted(VISCOUS)], tried(), NEITHER, {})[0])
    (found,) = judgement.contenders(stand, [fitted(VISCOUS, LOAD)], tried(), NEITHER, {})
    assert found.gate.beyond == pytest.approx(64.0)
    assert found.gate.passed
    assert not judged((VISCOUS,), VISCOUS, LOAD, friction=4000.0).gate.passed


def test_a_number_of_the_machine_file_has_no_equation_of_its_own_that_errs_but_by_what_it_does_as_a_law():
    beside = judged((VISCOUS,), VISCOUS, LOAD, friction=60.0)
    assert beside.gate.passed
    assert beside.by_numbers[0] == pytest.approx(0.98 * 3600.0)


def test_a_viscous_friction_s_error_as_a_law_is_not_counted_twice():
    """What its error functions hold of it is not in the temper of sets beside it."""
    judgement, fitted = bench(60.0, VISCOUS, errors=VISCOUS)
    stand = judgement.after(judgement.contenders(judgement.nothing, [fitted(VISCOUS)], tried(), NEITHER, {})[0])
    assert stand.known_energy[0] == pytest.approx(0.02 * 3600.0)
    assert stand.erring(lambda gate: gate.gain, NO_ERROR) == pytest.approx(
        WEIGHTS.form_error * 0.02 * 3600.0 + NUMBERS_ERROR * 0.98 * 3600.0
    )


def test_a_set_costs_the_logarithm_of_the_sets_there_were_to_choose_from():
    assert tried().searched([COULOMB]) == 0.0
    assert tried().searched([COULOMB, LOAD]) == pytest.approx(math.log(50 * 49 / 2 / 50))
    assert tried(shapes=100.0).searched([VISCOUS]) == pytest.approx(math.log(100.0))
    assert tried(shapes=100.0).sets([VISCOUS]) == pytest.approx(5000.0)


def test_a_set_of_more_effects_than_there_are_candidates_left_is_one_set_and_not_none():
    """Where what was found is tried again without one of its effects: none would pass whatever it gained."""
    assert Tried([Candidate(LOAD, ())], tried()).sets([VISCOUS, LOAD]) == pytest.approx(1.0)


@pytest.mark.parametrize(("second", "costs"), [(0.0, 0.0), (2.0, 2.0), (10.0, math.log(100.0))])
def test_a_searched_term_costs_no_more_than_what_it_does(second, costs):
    """An eccentricity's error once a turn was not searched: beside it the error per line, of an order that was, may be nothing."""
    eccentric, rows = EffectAt("encoder_eccentricity", "position_carriage"), np.eye(4)
    free = tuple((0, k) for k in range(4))  # a, phi, b, Nl
    fitted = Fitted((eccentric,), (np.array([9.0, 0.0, second, 50.0]),), np.zeros(0), rows[0], 0.0, free, rows, np.zeros(4))
    several = Tried([Candidate(eccentric, (), 100.0), *(Candidate(EffectAt("delay", f"{k}"), ()) for k in range(49))])
    assert several.searched_for(fitted) == pytest.approx(costs)


def test_what_was_searched_for_an_effect_found_before_is_kept():
    beside = Tried([Candidate(LOAD, ())], tried(shapes=100.0))
    assert beside.searched([VISCOUS, LOAD]) == pytest.approx(math.log(100.0) + math.log(49 / 2))
    assert beside.sets([LOAD]) == pytest.approx(1.0)


class OtherMotion:
    """A recording of another motion: what fits of friction and load say of it, and what is in it besides: noise, and an error of the
    friction's equation, half of which looks like a load turned round.
    """

    def __init__(self, noise: float = 1.0, errs: float = 0.0, **strengths: float) -> None:
        random = np.random.default_rng(7)
        directions = np.linalg.qr(random.standard_normal((ENTRIES, 3)))[0].T
        self._said = {
            e.effect: strengths[e.effect] * d for e, d in zip((COULOMB, LOAD, VISCOUS), directions, strict=True) if e.effect in strengths
        }
        drawn = random.standard_normal(ENTRIES)
        drawn -= sum((drawn @ d) * d for d in directions)
        drawn *= noise * math.sqrt(ENTRIES) / np.linalg.norm(drawn)
        self.error = (directions[2] - directions[1]) / math.sqrt(2.0)
        self.measured = drawn + sum(self._said.values()) + errs * self.error

    def follow(self, offset, settings):
        predicted = sum((self._said[setting.name] for setting in settings), np.zeros(ENTRIES))
        return Followed(predicted, offset, float(np.sum((self.measured - predicted) ** 2)))

    def misfit(self, found):
        return found.misfit

    def deviations(self, before, after):
        change = after.predicted - before.predicted
        return float(change @ (self.measured - before.predicted)) / float(np.linalg.norm(change))

    def squared_change(self, before, after):
        return float(np.sum((after.predicted - before.predicted) ** 2))


def followed(fall: float, variance: float) -> float:
    return float(scipy.stats.t.sf(math.sqrt(fall / variance) / HELD_OUT_SCALE, HELD_OUT_FREEDOM))


def test_a_held_out_fall_counts_in_units_of_what_is_left_there():
    for noise in (1.0, 2.0):
        judgement, fitted = bench(held_out=OtherMotion(noise, coulomb_friction=9.0))
        (found,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})
        assert found.gate.held_out_gain == pytest.approx(81.0)
        assert found.gate.followed == pytest.approx(followed(81.0, noise**2), rel=1e-3)
        assert (found.gate.predicted, found.gate.seen) == pytest.approx((9.0 / noise, 9.0 / noise), rel=1e-3)


def test_beside_a_large_effect_a_held_out_fall_must_exceed_what_its_equation_may_err_by():
    chances = []
    for friction in (6.0, 60.0):
        judgement, fitted = bench(friction, held_out=OtherMotion(coulomb_friction=friction, constant_load=8.0))
        stand = judgement.after(judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})[0])
        (found,) = judgement.contenders(stand, [fitted(COULOMB, LOAD)], tried(), NEITHER, {})
        assert found.gate.held_out_gain == pytest.approx(64.0)
        chances.append(found.gate.followed)
    assert chances[0] == pytest.approx(followed(64.0, 1.0), rel=0.5)
    assert chances[1] > 10.0 * chances[0]
    assert found.gate.predicted == pytest.approx(found.gate.seen) and found.gate.predicted < 8.0  # of 8, beyond that error


def test_a_held_out_fall_counts_without_what_errors_of_the_equations_found_before_do_there():
    """An error of 12, where it may be 6, hides a load of 8 from the misfit as it is. Against the matched filter in such noise."""
    motion = OtherMotion(errs=12.0, coulomb_friction=60.0, constant_load=8.0)
    judgement, fitted = bench(60.0, held_out=motion, errors=VISCOUS)
    stand = judgement.after(judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})[0])
    (found,) = judgement.contenders(stand, [fitted(COULOMB, LOAD)], tried(), NEITHER, {})
    assert found.gate.held_out_gain < -70.0
    load, left = motion._said["constant_load"], motion.measured - motion._said["coulomb_friction"]
    weighed = load - motion.error * (36.0 / 37.0) * (motion.error @ load)  # (1 + 36 e e')^-1
    assert found.gate.predicted == pytest.approx(math.sqrt(weighed @ load), rel=0.1)
    assert found.gate.seen == pytest.approx(weighed @ left / math.sqrt(weighed @ load), rel=0.1)
    assert found.gate.followed < 1e-3


def test_what_training_hardly_shows_may_be_more_than_the_simulator_s_error_in_another_motion():
    judgement, fitted = bench(1.5, held_out=OtherMotion(coulomb_friction=9.0))
    (found,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})
    assert found.gate.over_simulator == pytest.approx(81.0 / 4.0, rel=1e-3)


def test_what_is_left_held_out_says_nothing_of_what_chance_gains_in_training():
    chances = []
    for held_out in (None, OtherMotion(constant_load=8.0), OtherMotion(10.0, constant_load=8.0)):
        judgement, fitted = bench(held_out=held_out)
        (found,) = judgement.contenders(judgement.nothing, [fitted(LOAD)], tried(), NEITHER, {})
        chances.append(found.gate.trained)
    assert chances[1:] == pytest.approx([chances[0]] * 2)


def test_held_out_recordings_are_asked_about_as_many_sets_as_were_fitted():
    judgement, fitted = bench(held_out=OtherMotion(coulomb_friction=9.0, constant_load=8.0))
    fits = [fitted(COULOMB), fitted(LOAD), fitted(COULOMB, LOAD)]
    assert {found.gate.asked for found in judgement.contenders(judgement.nothing, fits, tried(), NEITHER, {})} == {3}


def test_what_repeats_scatter_along_a_response_widens_what_chance_gains_in_both():
    judgement, fitted = bench(held_out=OtherMotion(coulomb_friction=9.0), scattered=6.0)
    (found,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})
    assert found.gate.scatter > 5.0
    assert found.gate.followed == pytest.approx(followed(81.0, found.gate.scatter), rel=1e-3)
    by_chance = 50 * scipy.stats.f.sf(900.0 / found.gate.scatter, 1, TAIL_FREEDOM)
    assert found.gate.trained == pytest.approx(by_chance, rel=0.1)


def test_what_numbers_of_the_machine_file_remove_counts_in_both_motions():
    judgement, fitted = bench(found=VISCOUS, held_out=OtherMotion(viscous_friction=9.0))
    (found,) = judgement.contenders(judgement.nothing, [fitted(VISCOUS)], tried(), NEITHER, {})
    assert found.by_numbers == pytest.approx((0.98 * 900.0, 0.98 * 81.0))


@pytest.mark.parametrize(("another", "form", "is_closer"), [(1.0, "", True), (-1.0, "", False), (1.0, "it hardly slides", False)])
def test_a_closer_fit_of_what_passed_takes_its_place_where_it_passes_as_well(another, form, is_closer, monkeypatch):
    """A friction of which a fit took half, and one that is all of it; held out it may be turned round."""
    other = OtherMotion(coulomb_friction=9.0)
    judgement, fitted = bench(held_out=other)
    whole = fitted(COULOMB)
    half = replace(whole, predicted=0.5 * whole.predicted, cost=whole.cost + 225.0)
    other.measured = other.measured * another
    (found,) = judgement.contenders(judgement.nothing, [half], tried(), NEITHER, {})
    (alone,) = judgement.contenders(judgement.nothing, [whole], tried(), NEITHER, {})
    monkeypatch.setattr(judging, "lost_form", lambda *_: form)
    closer = judgement.closer(found, whole, tried(), {})
    assert (closer is not None) == is_closer
    if closer is not None:
        assert closer.gates == alone.gates and closer.gained_held_out == alone.gained_held_out
        assert closer.gate.gain > found.gate.gain


def test_sets_that_are_asked_about_later_in_a_step_count_those_before_them():
    judgement, fitted = bench(held_out=OtherMotion(coulomb_friction=9.0))
    (found,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {}, 8)
    (alone,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})
    assert found.gate.asked == 9
    assert found.gate.chance >= alone.gate.chance


def test_a_machine_that_diverges_on_the_held_out_motion_confirms_nothing():
    class Diverging(OtherMotion):
        def follow(self, offset, settings):
            return super().follow(offset, settings) if settings else None

        def misfit(self, found):
            return 1e300 if found is None else super().misfit(found)

        def deviations(self, before, after):
            return -np.inf if before is None or after is None else super().deviations(before, after)

    judgement, fitted = bench(held_out=Diverging(coulomb_friction=9.0))
    (found,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})
    assert found.gate.followed == 1.0
    assert not found.gate.passed


def test_what_chance_does_is_known_before_the_held_out_recordings_are_asked():
    judgement, fitted = bench()
    (first,) = judgement.contenders(judgement.nothing, [fitted(COULOMB)], tried(), NEITHER, {})
    stand = judgement.after(first)
    (found,) = judgement.contenders(stand, [fitted(COULOMB, LOAD)], tried(), NEITHER, {})
    assert judgement.by_chance(stand, fitted(COULOMB, LOAD), tried()) == found.gate.trained
    assert judgement.by_chance(stand, fitted(LOAD), tried()) == math.inf  # in place of the friction: what that gained is in it


@pytest.mark.parametrize(("elsewhere", "variance"), [(np.inf, 50.0), (1e3, 50.0), (30.0, 30.0), (0.0, 0.0)])
def test_an_error_has_the_rest_of_its_energy_elsewhere(elsewhere, variance):
    """Half alike: of an error of 100 half is along the response, and no more than is left beside it."""
    found, added = np.array([3.0, 0.0]), np.array([1.0, -1.0])
    assert form_variance(found, added, 100.0, 0.0, elsewhere) == pytest.approx(variance)
