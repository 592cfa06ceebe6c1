"""Sensitivities of tuned numbers, mended by the steps of a fit."""

from __future__ import annotations

import numpy as np
import pytest
from carriage import MACHINE

from hil.diagnosis.fitting.refit import refit
from hil.diagnosis.fitting.tuned_sensitivities import TunedSensitivities
from hil.diagnosis.judging.judgement import Judgement
from hil.diagnosis.judging.placebos import NO_PLACEBOS
from hil.diagnosis.judging.tried import Tried
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.starting.candidates import Candidate
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.retune import retune

ROWS, COUNT = 200, 12
FRICTION = EffectAt("coulomb_friction", "carriage")
THREE = {FRICTION: [8.0], EffectAt("constant_load", "carriage"): [1.0], EffectAt("cable_spring", "carriage"): [10.0, 0.0, 0.0]}


@pytest.fixture()
def jacobian():
    return np.random.default_rng(5).standard_normal((ROWS, COUNT))


def test_mended_sensitivities_say_of_a_step_what_it_did_and_nothing_new_across_it(jacobian):
    random = np.random.default_rng(6)
    tuned = TunedSensitivities.of(jacobian)
    for _ in range(3):
        move, missed = random.standard_normal(COUNT), random.standard_normal(ROWS)
        across = np.linalg.qr(np.column_stack([move, random.standard_normal(COUNT)]))[0][:, 1]
        before = tuned.along(move), tuned.along(across)
        tuned = tuned.after(move, 0.0, missed)
        assert tuned.along(move) == pytest.approx(before[0] + missed)
        assert tuned.along(across) == pytest.approx(before[1])


def test_products_are_those_of_the_mended_matrix(jacobian):
    random = np.random.default_rng(7)
    tuned = TunedSensitivities.of(jacobian)
    for _ in range(3):
        tuned = tuned.after(random.standard_normal(COUNT), 1.0, random.standard_normal(ROWS))
    whole = np.column_stack([tuned.along(unit) for unit in np.eye(COUNT)])
    vectors = random.standard_normal((ROWS, 2))
    assert tuned.across(vectors) == pytest.approx(whole.T @ vectors)
    assert tuned.square == pytest.approx(whole.T @ whole)


def test_of_what_a_step_missed_the_other_parameters_have_their_share(jacobian):
    move, missed = np.eye(COUNT)[0], np.ones(ROWS)
    tuned = TunedSensitivities.of(jacobian).after(move, 3.0, missed)
    assert tuned.along(move) == pytest.approx(jacobian @ move + 0.25 * missed)


def test_fits_of_a_machine_of_many_numbers_come_as_low_as_those_of_one_of_few(with_friction, monkeypatch):
    """The carriage has three numbers; called many, they are mended along the way, and fits that are behind are left."""
    starts = [((FRICTION,), (np.array([3.0]),)), (tuple(THREE), tuple(map(np.array, THREE.values())))]
    costs = []
    with FreeRuns({TRAIN: (found := mismatch(MACHINE, with_friction[0]))}, found.noise) as runs:
        tuning = retune(runs)
        for many in (3, 2):
            monkeypatch.setattr("hil.diagnosis.fitting.refit.MANY", many)
            costs.append([fit.cost for fit in refit(runs, tuning, runs.measured(), starts)])
    assert costs[1] == pytest.approx(costs[0], abs=3.0)
    assert costs[1] != costs[0]


def test_beside_a_channel_of_the_wrong_sign_the_file_s_numbers_move_it_the_other_way(with_friction):
    """What is looked for beside it is what they do not imitate there: with the sensitivities from before it, a drag of ten deviations would
    not show.
    """
    turned = EffectAt("rectified_sensor", "position_carriage")
    with FreeRuns({TRAIN: (found := mismatch(MACHINE, with_friction[0]))}, found.noise) as runs:
        tuning = retune(runs)
        judgement = Judgement(runs, tuning, None, float(len(tuning.predicted)))
        (fit,) = refit(runs, tuning, runs.measured(), [((turned,), (np.array([0.0, -1.0]),))])
        stand = judgement.after(
            judgement.contenders(judgement.nothing, [fit], Tried([Candidate(turned, ())]), (NO_PLACEBOS, NO_PLACEBOS), {})[0]
        )
        for column, (here, before) in enumerate(zip(stand.tuning.jacobian.T, tuning.jacobian.T, strict=True)):
            step = np.where(np.arange(len(tuning.offset)) == column, 1e-4, 0.0)
            moved, back = (runs.run_one(Trial(tuning.at(fit.offset + s * step), fit.settings)) for s in (1.0, -1.0))
            assert here == pytest.approx((moved - back) / 2e-4, abs=0.02 * np.abs(here).max())
            assert np.linalg.norm(here - before) > 0.5 * np.linalg.norm(here)
