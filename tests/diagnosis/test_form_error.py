"""What errors of an equation explain, against generalized least squares, and what they do to recordings, against the free run."""

from __future__ import annotations

import numpy as np
import pytest
from carriage import MACHINE, repeats

from hil.diagnosis.align import aligned
from hil.diagnosis.candidates import setting_of
from hil.diagnosis.form_error import NO_ERROR, FormError, can_err, form_error
from hil.diagnosis.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.mismatch import mismatch
from hil.diagnosis.refit import Fitted
from hil.diagnosis.result import EffectAt
from hil.diagnosis.retune import retune

ENTRIES = 60


def test_energy_taken_and_gain_are_those_of_generalized_least_squares():
    random = np.random.default_rng(4)
    rows, residual, response = random.standard_normal((5, ENTRIES)), random.standard_normal(ENTRIES), random.standard_normal(ENTRIES)
    inverse = np.linalg.inv(np.eye(ENTRIES) + rows.T @ rows)
    errors = FormError(rows)
    assert errors.taken_by(residual) == pytest.approx(residual @ residual - residual @ inverse @ residual)
    residual += 3.0 * response
    amplitude = (response @ inverse @ residual) / (response @ inverse @ response)
    left = residual - amplitude * response
    assert errors.gain(residual, response) == pytest.approx(residual @ inverse @ residual - left @ inverse @ left)
    assert errors.gain(-residual, response) == 0.0


def test_an_effect_counts_in_full_outside_of_errors_and_hardly_within():
    within, outside = 10.0 * np.eye(ENTRIES)[:2]
    errors = FormError(within[None, :])
    assert errors.gain(outside, outside) == pytest.approx(100.0)
    assert errors.gain(within, within) == pytest.approx(100.0 / 101.0)
    assert NO_ERROR.gain(within, within) == pytest.approx(100.0)


@pytest.fixture(scope="module")
def carriage():
    found = mismatch(MACHINE, aligned(MACHINE, repeats(3, duration_s=2.0)))
    with FreeRuns({TRAIN: found}, found.noise) as runs:
        yield runs, retune(runs)


def fitted(runs, tuning, *found: tuple[str, list[float]]) -> Fitted:
    """These effects at the carriage, as a fit would have left them."""
    effects, values = [EffectAt(name, "carriage") for name, _ in found], [np.array(own) for _, own in found]
    settings = tuple(setting_of(effect, own) for effect, own in zip(effects, values, strict=True))
    predicted = runs.run_one(Trial(tuning.values, settings))
    return Fitted(tuple(effects), tuple(values), tuning.offset, predicted, 0.0, (), np.zeros((len(predicted), 0)), np.zeros(0))


def within(carriage, found: tuple[str, list[float]], other: tuple[str, list[float]]) -> tuple[FormError, np.ndarray, float]:
    """Errors of an effect, another one's change of the free run, and the share of its energy that the errors span."""
    runs, tuning = carriage
    errors = form_error(runs, TRAIN, tuning, fitted(runs, tuning, found))
    answer = fitted(runs, tuning, other).predicted - tuning.predicted
    left = answer - np.linalg.lstsq(errors.responses.T, answer, rcond=1e-8)[0] @ errors.responses
    return errors, answer, 1.0 - float(left @ left) / float(answer @ answer)


FRICTION, SPRING = ("coulomb_friction", [2.0]), ("cable_spring", [20.0, 0.0, 0.0])


def test_another_friction_of_the_same_joint_is_an_error_of_the_one_that_was_found(carriage):
    assert within(carriage, ("viscous_friction", [20.0]), FRICTION)[2] > 0.95
    assert within(carriage, FRICTION, ("quadratic_friction", [50.0]))[2] > 0.95


def test_a_spring_is_no_error_of_a_friction_nor_a_friction_one_of_a_spring(carriage):
    assert within(carriage, FRICTION, SPRING)[2] < 0.5
    assert within(carriage, SPRING, FRICTION)[2] < 0.5


def test_another_friction_counts_where_it_is_more_than_an_error_of_the_first(carriage):
    """Both stand out of the noise by far, alone: 3 % of the first is an error of it, as much as it is not."""
    for share, counts in ((0.03, False), (1.0, True)):
        errors, answer, _ = within(carriage, ("coulomb_friction", [50.0]), ("viscous_friction", [share * 50.0 / 0.2]))  # at 0.2 m/s
        assert answer @ answer > 50.0
        assert (errors.gain(answer, answer) > 100.0) is counts
        assert (errors.gain(answer, answer) < 1.0) is not counts


def test_what_is_no_function_of_a_joint_s_motion_is_left_to_the_general_rule(carriage):
    runs, tuning = carriage
    assert can_err(EffectAt("cogging", "carriage"))
    assert not can_err(EffectAt("imu_scale_bias", "imu"))
    assert form_error(runs, TRAIN, tuning, fitted(runs, tuning, ("torque_constant", [1.05]))) is NO_ERROR
