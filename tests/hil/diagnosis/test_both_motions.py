"""Parameters of a set as training and held-out recordings want them together: a carriage's friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import MACHINE, MASS_kg, repeats

from hil.diagnosis.fitting.refit import refit
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.judging.judgement import Contender
from hil.diagnosis.ranking.both_motions import with_both_motions
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns
from hil.diagnosis.tuning.retune import retune

FRICTION = EffectAt("coulomb_friction", "carriage")
COULOMB_N, DURATION_s = 20.0, 2.0


def moved(train, held_out, seen=1.0, tempers=(1.0, 1.0)) -> tuple[Contender, Contender]:
    """A friction fitted to the training recordings, and as both motions want it. Where training does not show it (`seen` 0), chance has put
    it a quarter too low.
    """
    found = mismatch(MACHINE, train)
    sets = {TRAIN: found, HELD_OUT: mismatch(MACHINE, held_out, channels=found.channels, noise=found.noise)}
    with FreeRuns(sets, found.noise) as runs:
        tuning = retune(runs)
        judged = HeldOut(runs, tuning)
        (fitted,) = refit(runs, tuning, runs.measured(), [((FRICTION,), (np.array([10.0]),))])
        if not seen:
            blind = replace(fitted, values=(0.75 * fitted.values[0],), jacobian=0.0 * fitted.jacobian)
            runs.run_one = lambda trial, name=TRAIN, run=runs.run_one: fitted.predicted if name == TRAIN else run(trial, name)
            fitted = blind
        left = judged.misfit(judged.follow(fitted.offset, fitted.settings))
        before = Contender(fitted, 1000.0, 1000.0, left, ())
        (after,) = with_both_motions(runs, tuning, judged, [before], tempers)
        return before, after


def strength(one: Contender) -> float:
    return float((one.fitted if one.moved is None else one.moved).values[0][0])


@pytest.mark.nightly
def test_what_training_does_not_show_is_where_held_out_recordings_want_it(with_friction):
    before, after = moved(*with_friction, seen=0.0)
    assert strength(before) == pytest.approx(0.75 * COULOMB_N, rel=0.03)
    assert 0.85 * COULOMB_N < strength(after) < 1.03 * COULOMB_N  # the machine's numbers, which follow too, do the rest
    assert after.gained == pytest.approx(before.gained, abs=1.0)
    assert after.gained_held_out - before.gained_held_out == pytest.approx(before.left_held_out - after.left_held_out)
    assert after.left_held_out < before.left_held_out - 400.0


def test_what_both_motions_show_alike_stays(with_friction):
    before, after = moved(*with_friction)
    assert strength(after) == pytest.approx(strength(before), rel=0.02)


def test_what_training_knows_gives_way_only_as_far_as_it_costs_there(with_friction):
    train, _ = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=0.5 * COULOMB_N, duration_s=DURATION_s)
    before, after = moved(train, other)
    assert 0.55 * COULOMB_N < strength(after) < strength(before)
    rise = before.gained - after.gained
    assert rise > 0.0
    assert rise < before.left_held_out - after.left_held_out


def test_a_motion_that_the_law_is_far_from_says_little_of_its_parameters(with_friction):
    """Half as much friction there is as likely the equation's error as another friction."""
    train, _ = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=0.5 * COULOMB_N, duration_s=DURATION_s)
    before, near = moved(train, other, tempers=(1.0, 1e4))
    assert strength(near) > 0.97 * strength(before)
    _, alike = moved(train, other, tempers=(1e2, 1e2))
    _, exact = moved(train, other)
    assert strength(exact) < 0.95 * strength(before)  # 18.6 of 19.8 N: where both count alike it moves
    assert strength(alike) == pytest.approx(strength(exact), rel=0.02)  # a common factor tells nothing apart
