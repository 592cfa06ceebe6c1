"""What a set of effects is judged against, and what its search costs."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.candidates import Candidate
from hil.diagnosis.judgement import Contender, Judgement, Tried
from hil.diagnosis.refit import Fitted
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import Tuning

ENTRIES = 4000
COULOMB, LOAD, VISCOUS = (EffectAt(name, "carriage") for name in ("coulomb_friction", "constant_load", "viscous_friction"))


def tried(count: int = 50, shapes: float = 1.0) -> Tried:
    others = [Candidate(EffectAt("delay", f"axis_{n}"), ()) for n in range(count - 3)]
    return Tried([Candidate(COULOMB, ()), Candidate(LOAD, ()), Candidate(VISCOUS, (), shapes), *others])


def bench(friction: float = 30.0, found: EffectAt = COULOMB, *, apart: bool = False):
    """A judgement of noise with a friction and a load of 8 in it along directions of their own, and what fits their amplitudes.

    `apart`: the load shows where friction does not.
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
    runs = SimpleNamespace(measured=lambda: measured, repeats=lambda name: [[noise]])

    def fitted(*effects: EffectAt) -> Fitted:
        predicted = sum((measured @ directions[e]) * directions[e] for e in effects)
        cost = float(np.sum((measured - predicted) ** 2))
        free = tuple((e, 0) for e in range(len(effects)))
        return Fitted(
            effects, ((np.ones(1),) * len(effects)), np.zeros(0), predicted, cost, free, np.zeros((ENTRIES, len(effects))), np.ones(1)
        )

    return Judgement(runs, tuning, None, float(ENTRIES)), fitted


def judged(before: tuple[EffectAt, ...], *effects: EffectAt, friction: float = 30.0, apart: bool = False) -> Contender:
    judgement, fitted = bench(friction, before[0], apart=apart)
    stand = judgement.nothing
    if before:
        stand = judgement.after(judgement.contenders(stand, [fitted(*before)], tried(), 0.0, {})[0])
    (found,) = judgement.contenders(stand, [fitted(*effects)], tried(), 0.0, {})
    return found


def test_an_effect_beside_another_is_judged_by_what_it_adds():
    found = judged((COULOMB,), COULOMB, LOAD)
    assert [gate.gain for gate in found.gates] == pytest.approx([900.0, 64.0])
    assert [gate.is_first for gate in found.gates] == [True, False]
    assert found.gained == pytest.approx(964.0)


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


def test_a_number_of_the_machine_file_has_no_equation_of_its_own_that_errs():
    beside = judged((VISCOUS,), VISCOUS, LOAD, friction=60.0)
    assert beside.gate.passed
    assert beside.by_numbers == pytest.approx(3600.0)


def test_a_set_costs_the_logarithm_of_the_sets_there_were_to_choose_from():
    assert tried().searched([COULOMB]) == 0.0
    assert tried().searched([COULOMB, LOAD]) == pytest.approx(math.log(50 * 49 / 2 / 50))
    assert tried(shapes=100.0).searched([VISCOUS]) == pytest.approx(math.log(100.0))
    assert tried(shapes=100.0).sets([VISCOUS]) == pytest.approx(5000.0)


def test_what_was_searched_for_an_effect_found_before_is_kept():
    beside = Tried([Candidate(LOAD, ())], tried(shapes=100.0))
    assert beside.searched([VISCOUS, LOAD]) == pytest.approx(math.log(100.0) + math.log(49 / 2))
    assert beside.sets([LOAD]) == pytest.approx(1.0)
