"""Whether two motions want the same values of a law's parameters: a carriage whose friction is the same in both, and one whose is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from carriage import DAMPING, MACHINE, MASS_kg, repeats

from hil.diagnosis.answering.drift import DRIFTED, chance_of_drift
from hil.diagnosis.fitting.refit import refit, sensitivities_to_effects
from hil.diagnosis.judging.errors_of_laws import NUMBERS, erring, share_of_numbers
from hil.diagnosis.judging.held_out import HeldOut
from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.result import EffectAt
from hil.diagnosis.tuning.free_run import HELD_OUT, TRAIN, FreeRuns
from hil.diagnosis.tuning.retune import retune

FRICTION = EffectAt("coulomb_friction", "carriage")
VISCOUS = EffectAt("viscous_friction", "carriage")
COULOMB_N, DURATION_s = 20.0, 2.0
"""Of `with_friction`."""


def drift(train, held_out, effects=(FRICTION,), starts=(10.0,), seen=1.0, nearer=0.0, turned=lambda own: own) -> float:
    """Chance of it where training shows the parameters, and where it does not (`seen` 0); asked from training's values, from so much nearer
    to nothing, or from the same values written otherwise (`turned`).
    """
    found = mismatch(MACHINE, train)
    sets = {TRAIN: found, HELD_OUT: mismatch(MACHINE, held_out, channels=found.channels, noise=found.noise)}
    with FreeRuns(sets, found.noise) as runs:
        tuning = retune(runs)
        judged = HeldOut(runs, tuning)
        (fitted,) = refit(runs, tuning, runs.measured(), [(effects, tuple(np.atleast_1d(start) for start in starts))])
        nothing, friction = judged.follow(tuning.offset, ()), judged.follow(fitted.offset, fitted.settings)
        removed = float(np.sum((runs.measured() - tuning.predicted) ** 2)) - fitted.cost
        known = replace(fitted, jacobian=seen * fitted.jacobian)
        energies = removed, judged.misfit(nothing) - judged.misfit(friction)
        by_numbers = share_of_numbers(effects) if effects[0].effect in NUMBERS else 0.0
        near = replace(fitted, values=tuple((1.0 - nearer) * own for own in fitted.values)) if nearer else None
        if near is None:
            near = replace(fitted, values=tuple(turned(own) for own in fitted.values))
        return chance_of_drift(runs, tuning, judged, known, tuple(erring(energy, by_numbers * energy) for energy in energies), near)


def test_one_friction_is_the_same_in_another_motion(with_friction):
    assert drift(*with_friction) > 0.01


@pytest.mark.parametrize(("disturbance_N", "seed"), [(0.1, 0), (1.0, 0), (1.0, 1), (1.0, 3)])
def test_a_number_of_the_machine_file_is_the_same_in_another_motion(disturbance_N, seed):
    """Damping four times the file's: its equation is the machine's own, but no fit is better than a part in a thousand, and strengths
    scatter over repeats of 1 N by sixty times what the noise model says.
    """
    one = {"duration_s": DURATION_s, "disturbance_N": disturbance_N, "damping": 4.0 * DAMPING, "seed": seed}
    assert drift(repeats(4, **one), repeats(1, experiment=1, **one), (VISCOUS,), (400.0,)) > DRIFTED


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_what_only_looks_like_a_friction_wants_another_one_there(with_friction, share):
    train, _ = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=share * COULOMB_N, duration_s=DURATION_s)
    assert drift(train, other) < DRIFTED


@pytest.mark.parametrize("nearer", [0.2, 0.5])
def test_from_where_it_is_asked_makes_no_drift_and_hides_none(with_friction, nearer):
    train, same = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=0.5 * COULOMB_N, duration_s=DURATION_s)
    assert drift(train, same, nearer=nearer) > 0.01
    assert drift(train, other, nearer=nearer) < DRIFTED


def a_turn_on(own: np.ndarray) -> np.ndarray:
    return np.append(own[:-1], own[-1] + 2.0 * np.pi)


def a_turn_back(own: np.ndarray) -> np.ndarray:
    return np.array([*own[:2], own[2] - 2.0 * np.pi, *own[3:]])


def half_a_turn_on(own: np.ndarray) -> np.ndarray:
    """With the amplitude the other way."""
    return np.array([own[0], -own[1], own[2] + np.pi, *own[3:]])


@pytest.mark.parametrize("turned", [a_turn_on, a_turn_back, half_a_turn_on])
def test_a_wave_that_is_written_otherwise_is_the_same_wave(with_friction, turned):
    """A fit at +3 rad that both motions move to -3 rad has gone a little further, not back by six."""
    wave = {"effects": (EffectAt("cogging", "carriage"),), "starts": (np.array([20.0, 3.0, 1.0, 1.0, 1.0]),)}
    assert drift(*with_friction, **wave, turned=turned) == pytest.approx(drift(*with_friction, **wave), rel=1e-3)


def test_an_equation_may_err_by_a_part_in_either_motion(with_friction):
    train, _ = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=1.1 * COULOMB_N, duration_s=DURATION_s)
    assert drift(train, other) > DRIFTED


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_what_training_does_not_show_may_be_anything_held_out(with_friction):
    train, _ = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=0.3 * COULOMB_N, duration_s=DURATION_s)
    assert drift(train, other, seen=0.0) > 0.1


def test_a_parameter_that_training_does_not_show_hides_no_other(with_friction):
    train, _ = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=0.3 * COULOMB_N, duration_s=DURATION_s)
    assert drift(train, other, (FRICTION, VISCOUS), (10.0, 20.0), seen=np.array([1.0, 0.0])) < DRIFTED


def test_a_parameter_that_held_out_recordings_do_not_show_hides_no_other(with_friction, monkeypatch):
    train, same = with_friction
    other = repeats(1, experiment=1, mass=1.05 * MASS_kg, coulomb_N=0.3 * COULOMB_N, duration_s=DURATION_s)
    monkeypatch.setattr(
        "hil.diagnosis.answering.drift.sensitivities_to_effects", lambda *asked: sensitivities_to_effects(*asked) * [1.0, 0.0]
    )
    assert drift(train, same, (FRICTION, VISCOUS), (10.0, 20.0)) > 0.01
    assert drift(train, other, (FRICTION, VISCOUS), (10.0, 20.0)) < DRIFTED
