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


def share_within(carriage, found: tuple[str, list[float]], other: tuple[str, list[float]]) -> float:
    """Of what another effect changes in the free run, the share of its energy that errors of the one that was found span."""
    runs, tuning = carriage
    effect, change = EffectAt(found[0], "carriage"), EffectAt(other[0], "carriage")
    rows = form_error(runs, TRAIN, tuning, [(effect, np.array(found[1]), 1.0)]).responses
    answer = runs.run_one(Trial(tuning.values, (setting_of(change, np.array(other[1])),))) - tuning.predicted
    left = answer - np.linalg.lstsq(rows.T, answer, rcond=1e-8)[0] @ rows
    return 1.0 - float(left @ left) / float(answer @ answer)


FRICTION, LOAD, SPRING = ("coulomb_friction", [2.0]), ("constant_load", [2.0]), ("cable_spring", [20.0, 0.0, 0.0])


def test_another_friction_of_the_same_joint_is_an_error_of_the_one_that_was_found(carriage):
    assert share_within(carriage, ("viscous_friction", [20.0]), FRICTION) > 0.9
    assert share_within(carriage, FRICTION, ("quadratic_friction", [50.0])) > 0.9


def test_a_spring_is_no_error_of_a_friction_nor_a_friction_one_of_a_spring(carriage):
    assert share_within(carriage, FRICTION, SPRING) < 0.5
    assert share_within(carriage, SPRING, FRICTION) < 0.5


def test_errors_have_the_energy_that_is_given_them(carriage):
    runs, tuning = carriage
    given = [
        (EffectAt("coulomb_friction", "carriage"), np.array([2.0]), 7.0),
        (EffectAt("cogging", "carriage"), np.array([30.0, 1.0, 0.0, 0.0, 0.0]), 2.0),
    ]
    assert np.sum(form_error(runs, TRAIN, tuning, given).responses ** 2) == pytest.approx(9.0)
    assert form_error(runs, TRAIN, tuning, []) is NO_ERROR


def test_what_is_no_function_of_a_joint_s_motion_is_left_to_the_general_rule():
    assert can_err(EffectAt("cogging", "carriage"))
    assert not can_err(EffectAt("imu_scale_bias", "imu"))
    assert not can_err(EffectAt("torque_constant", "carriage"))
