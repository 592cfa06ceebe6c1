"""Held-out recordings: the machine's numbers move to where they want them, as far as the training recordings let them go."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hil.diagnosis.fitting.refit import MANY
from hil.diagnosis.judging.held_out import OPEN, HeldOut
from hil.diagnosis.tuning.free_run import HELD_OUT
from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.plant.parameters import PlantParameter
from virtual_bus.settings import EffectSetting

ROWS = 2000
NOISE = np.random.default_rng(4).standard_normal(ROWS)
PUSH = EffectSetting("constant_load", "axis", {"tau0": 1.0})


def held_out(answer, measured: np.ndarray, known: float | np.ndarray, numbers: int = 1) -> HeldOut:
    """A machine that answers the held-out motion with `answer(offset, effects)` and whose numbers training sees with `known` sensitivities.

    Numbers are one at nominal, and an offset of 1 is a tenth of them.
    """
    parameters = tuple(PlantParameter(f"body_{k}", "mass", "kg", 1.0) for k in range(numbers))
    zeros, seen = np.zeros(numbers), known * np.eye(ROWS, numbers)
    tuning = Tuning(parameters, np.arange(numbers), zeros + 0.1, zeros, zeros + 1.0, np.zeros(ROWS), seen, np.eye(numbers))

    def run(trials, name):
        assert name == HELD_OUT
        return [answer(10.0 * (trial.values - 1.0), trial.effects) for trial in trials]

    runs = SimpleNamespace(measured=lambda name: measured, run=run, run_one=lambda trial, name: run([trial], name)[0])
    return HeldOut(runs, tuning)


def wave(offset, effects=()):
    """A lightly damped mode rings on for ten turns: half a turn less where its spring is a tenth softer."""
    phase = np.linspace(0.0, 20.0 * np.pi, ROWS)
    pushed = 3.0 * np.ones(ROWS) if effects else 0.0
    return 5.0 * np.sin(phase * np.sqrt(1.0 + 0.1 * offset[0])) + pushed


def test_what_is_left_open_follows_a_mode_that_is_far_from_linear():
    true = np.array([-0.8])
    measured = wave(true) + NOISE
    judge = held_out(wave, measured, 0.0)
    nothing = judge.follow(np.zeros(1), ())
    assert np.sum((measured - wave(np.zeros(1))) ** 2) > 5.0 * ROWS
    assert nothing.misfit == pytest.approx(NOISE @ NOISE + 0.64, abs=4.0)
    assert nothing.moved == pytest.approx(true, abs=0.02)


def test_an_effect_that_is_none_gains_nothing_by_starting_nearer():
    true = np.array([-0.8])
    judge = held_out(wave, wave(true) + NOISE, 0.0)
    nothing, nearer = judge.follow(np.zeros(1), ()), judge.follow(0.9 * true, ())
    assert nothing.misfit - nearer.misfit < 1.0  # the move's own price, of 0.64


@pytest.mark.parametrize("numbers", [1, MANY + 1])
def test_an_effect_that_is_there_is_followed_with_the_numbers_moved_all_the_same(numbers):
    measured = wave(np.array([-0.8]), (PUSH,)) + NOISE
    judge = held_out(wave, measured, 0.0, numbers)
    nothing, pushed = judge.follow(np.zeros(numbers), ()), judge.follow(np.zeros(numbers), (PUSH,))
    assert nothing.misfit - pushed.misfit == pytest.approx(9.0 * ROWS, rel=0.05)
    assert judge.deviations(nothing, pushed) == pytest.approx(3.0 * np.sqrt(ROWS), rel=0.05)
    assert judge.deviations(pushed, pushed) == 0.0


def test_what_training_knows_does_not_move():
    measured = wave(np.array([-0.8])) + NOISE
    loose, firm = (held_out(wave, measured, known).follow(np.zeros(1), ()) for known in (0.0, 1e5))
    assert abs(firm.moved[0]) < 1e-3
    assert firm.misfit > 5.0 * loose.misfit


def test_numbers_stay_within_fifteen_percent():
    judge = held_out(wave, wave(np.array([-1.9])) + NOISE, 0.0)
    assert judge.follow(np.array([-1.2]), ()).moved >= -0.3 - 1e-6


def test_the_misfit_of_a_linear_machine_is_that_under_its_prediction_s_covariance():
    random = np.random.default_rng(5)
    seen, known = random.standard_normal((ROWS, 3)), 4.0
    judge = held_out(lambda offset, effects: seen @ offset, NOISE, known, 3)
    covariance = np.eye(ROWS) + seen @ seen.T / (known**2 / OPEN + 1.0)
    other = random.standard_normal((ROWS, 2))
    solved = np.linalg.solve(covariance, np.column_stack([NOISE, other]))
    assert judge.follow(np.zeros(3), ()).misfit == pytest.approx(NOISE @ solved[:, 0], rel=1e-6)
    assert judge.information(other, np.ones(3, dtype=bool)) == pytest.approx(other.T @ solved[:, 1:], rel=1e-6)
    fewer = np.linalg.solve(np.eye(ROWS) + seen[:, :2] @ seen[:, :2].T / (known**2 / OPEN + 1.0), other)
    assert judge.information(other, np.array([True, True, False])) == pytest.approx(other.T @ fewer, rel=1e-6)


def test_what_cannot_be_simulated_is_no_better_than_anything():
    judge = held_out(lambda offset, effects: None if effects else wave(offset), NOISE, 0.0)
    failed = judge.follow(np.zeros(1), (PUSH,))
    assert failed is None
    assert judge.misfit(failed) > 1e200
    assert judge.deviations(judge.follow(np.zeros(1), ()), failed) == -np.inf


def test_a_machine_of_no_numbers_stays_as_it_is():
    judge = held_out(lambda offset, effects: np.zeros(ROWS), NOISE, 0.0, 0)
    assert judge.follow(np.zeros(0), ()).misfit == pytest.approx(NOISE @ NOISE)


def test_sensitivities_are_not_taken_again_where_no_step_helps():
    """A kink: downhill by the difference that is taken of it, uphill every way."""
    shape, asked = np.sin(np.linspace(0.0, 60.0, ROWS)), []

    def kinked(offset, effects=()):
        asked.append(offset)
        return shape * (3.0 + abs(offset[0])) if effects else 0.0 * shape

    judge = held_out(kinked, -shape, 0.0)
    asked.clear()
    assert judge.follow(np.zeros(1), (PUSH,)).moved == pytest.approx(0.0)
    assert len(asked) < 20


SHAPE = np.sin(np.linspace(0.0, 60.0, ROWS))


def loaded(offset, effects=()):
    """A number that does nothing on the machine without the effect, and much beside it."""
    return SHAPE * (3.0 + 0.5 * offset[0]) if effects else 0.0 * SHAPE


@pytest.mark.parametrize("numbers", [1, MANY + 1])
def test_numbers_settle_by_the_sensitivities_of_the_set_itself(numbers):
    true = np.array([0.8])
    followed = held_out(loaded, loaded(true, (PUSH,)) + NOISE, 0.0, numbers).follow(np.zeros(numbers), (PUSH,))
    assert followed.moved[0] == pytest.approx(true[0], abs=0.2)
    assert followed.misfit == pytest.approx(NOISE @ NOISE + 0.64, abs=4.0)


def test_many_numbers_are_asked_about_once_where_runs_differ_as_they_said_and_not_for_sets_that_are_alike():
    asked = []

    def counted(offset, effects=()):
        asked.append(effects)
        return loaded(offset, effects)

    judge = held_out(counted, loaded(np.array([0.8]), (PUSH,)) + NOISE, 0.0, MANY + 1)
    asked.clear()
    first = judge.follow(np.zeros(MANY + 1), (PUSH,))
    assert np.sum((first.predicted - loaded(np.zeros(1), (PUSH,))) ** 2) > 0.05 * ROWS
    assert MANY < len(asked) < 2 * MANY
    asked.clear()
    another = judge.follow(np.zeros(MANY + 1), (replace(PUSH, at="other"),))
    assert another.misfit == pytest.approx(first.misfit, abs=0.1)
    assert len(asked) < 10


def test_many_numbers_are_asked_about_again_where_a_run_differs_otherwise_than_they_said():
    def curved(offset, effects=()):
        return SHAPE * (3.0 + 0.5 * offset[0] + 2.0 * np.sin(offset[0])) if effects else 0.0 * SHAPE

    true = np.array([1.3])
    followed = held_out(curved, curved(true, (PUSH,)) + NOISE, 0.0, MANY + 1).follow(np.zeros(MANY + 1), (PUSH,))
    assert followed.misfit == pytest.approx(NOISE @ NOISE + true[0] ** 2, abs=4.0)


@pytest.mark.parametrize("numbers", [1, MANY + 1])
def test_sensitivities_of_another_set_that_say_otherwise_than_a_run_are_taken_again_although_that_is_alike(numbers):
    """A number that pushes the other way beside the effect, whose runs at first are the same: 57 of the misfit are asked about anew."""

    def turned(offset, effects=()):
        return SHAPE * 0.3 * (-offset[0] if effects else offset[0])

    true = np.array([-0.8])
    judge = held_out(turned, turned(true, (PUSH,)) + NOISE, 0.0, numbers)
    assert judge.follow(np.zeros(numbers), (PUSH,)).misfit == pytest.approx(NOISE @ NOISE + true[0] ** 2, abs=4.0)


def test_many_numbers_are_asked_about_again_where_a_run_differs_by_little_otherwise_than_they_said():
    """By 14, of 264 by which it differs: sensitivities may change by twice that, which is 57 and more than is left out of 2000."""
    other = np.cos(np.linspace(0.0, 60.0, ROWS))

    def bent(offset, effects=()):
        return 0.5 * other * offset[1] + (SHAPE * (0.12 + 0.3 * offset[0]) if effects else 0.0)

    known, true = np.zeros(MANY + 1), np.zeros(MANY + 1)
    known[1], true[:2] = 1e5, (0.8, 1.0)  # the second is known, and fitted with the effect
    judge = held_out(bent, bent(true, (PUSH,)) + NOISE, known, MANY + 1)
    assert judge.follow(np.eye(MANY + 1)[1], (PUSH,)).misfit == pytest.approx(NOISE @ NOISE + true[0] ** 2, abs=4.0)


def test_a_set_that_is_asked_for_again_is_not_run_again():
    asked = []

    def counted(offset, effects=()):
        asked.append(effects)
        return wave(offset, effects)

    judge = held_out(counted, wave(np.array([-0.8]), (PUSH,)) + NOISE, 0.0)
    first, before = judge.follow(np.zeros(1), (PUSH,)), len(asked)
    again = EffectSetting("constant_load", "axis", {"tau0": 1.0})
    assert judge.follow(np.zeros(1), (again,)) is first
    assert len(asked) == before
    for another in (replace(PUSH, parameters={"tau0": 2.0}),), (replace(PUSH, at="other"),), (replace(PUSH, name="payload"),), ():
        assert judge.follow(np.zeros(1), another) is not first
    assert judge.follow(np.array([0.1]), (PUSH,)) is not first


def test_sets_that_are_expected_are_followed_as_each_alone():
    """Their first runs are begun together, each asked for once."""
    true, asked = np.array([-0.8]), []
    fits = [SimpleNamespace(offset=np.array([0.3 * k]), settings=(PUSH,) if k % 2 else ()) for k in range(1, 5)]
    alone, together = (held_out(wave, wave(true) + NOISE, 0.0) for _ in range(2))

    def begin(trials, name):
        asked.append(len(trials))
        return lambda: [wave(10.0 * (trial.values - 1.0), trial.effects) for trial in trials]

    together._runs.begin = begin
    together.expect([*fits, fits[0]])
    together.expect(fits)
    assert asked == [2 * len(fits)]
    for fit in reversed(fits):
        one, other = (judge.follow(fit.offset, fit.settings) for judge in (alone, together))
        assert one.misfit == other.misfit and np.array_equal(one.predicted, other.predicted)
    together.expect(fits[:1])  # known, or too few
    assert len(asked) == 1
