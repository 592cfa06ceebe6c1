"""Laws that are a little wrong, and scores of efforts: against dense linear algebra, and on machines whose laws are not the catalogue's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from carriage import MACHINE, disturbance, recording, reference, run

from hil.diagnosis.candidates.columns import Column
from hil.diagnosis.model_choice.choose import Choice, choose_effects
from hil.diagnosis.model_choice.form_error import FORM, FormError, form_columns
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.residuals.trajectory import Motion
from hil.diagnosis.retuning.linear_model import LinearModel, linear_at, nominal_offset
from hil.recording import Recording

RATE_Hz = 1000.0
REPEATS, DURATION_s = 3, 5.0


def test_form_errors_are_noise_with_the_covariance_of_their_columns() -> None:
    random = np.random.default_rng(5)
    columns = [random.standard_normal((40, 3)), random.standard_normal((25, 3))]
    left = [random.standard_normal(40), random.standard_normal(25)]
    dispersion = 1.7
    form = FormError(columns, dispersion)
    reduced, size = form.taken_from(left)
    cost = sum(float(rest @ rest) for rest in reduced) / dispersion + size
    stacked, whole = np.vstack(columns), np.concatenate(left)
    covariance = dispersion * np.eye(len(whole)) + stacked @ stacked.T
    assert cost == pytest.approx(float(whole @ np.linalg.solve(covariance, whole)), rel=1e-10)
    determinant = np.linalg.slogdet(covariance)[1] - len(whole) * np.log(dispersion)
    assert form.log_determinant(dispersion) == pytest.approx(float(determinant), rel=1e-10)


def test_a_form_error_is_a_tenth_of_its_law_and_the_same_both_ways() -> None:
    count = 20_001
    position, zero = np.linspace(-0.5, 0.7, count), np.zeros(count)
    speed = np.random.default_rng(2).uniform(-1.0, 1.0, count)  # every speed as often at every position
    law = np.sign(speed)
    found = []
    for sign in (1.0, -1.0):
        motion = Motion(position[:, None], sign * speed[:, None], zero[:, None], zero[:, None])
        found.append([each.efforts[0][0] for each in form_columns(Column({0: (law, law)}, {}), motion)])
    there, back = np.array(found)
    np.testing.assert_allclose(there, back, atol=1e-6)
    assert np.sqrt(np.mean(np.sum(there**2, axis=0))) == pytest.approx(FORM, rel=0.02)


def carried(at: Callable[[float], float] = lambda x: 0.0, friction_N: float = 0.0, seeds: int = 0) -> dict[str, Recording]:
    """Repeats of two experiments, disturbed by forces of their own."""
    found = {}
    for experiment in range(2):
        wanted = reference(DURATION_s, experiment)
        for repeat in range(REPEATS):
            seed = seeds + 10 * experiment + repeat
            position, command = run(wanted, coulomb_N=friction_N, force_N=disturbance(len(wanted), 3.0, seed), at=at, noise_seed=seed)
            found[f"run_{experiment}_{repeat}"] = recording(wanted, position, command)
    return found


@pytest.fixture(scope="module")
def still_sound() -> LinearModel:
    residuals = residuals_of(MACHINE, carried())
    return linear_at(residuals.trajectories, residuals.levels, nominal_offset(residuals.trajectories))


def test_scores_are_the_adjoint_of_whitening(still_sound: LinearModel) -> None:
    one, random = still_sound.records[0], np.random.default_rng(8)
    rows, joints = one.equations.missing.shape
    for joint in range(joints):
        effort = random.standard_normal(rows).astype(np.float32)
        whitened = one.whiten([Column({joint: (effort, effort)}, {})])[:, 0]
        against = random.standard_normal(whitened.shape)
        scores = one.whitening.scores(against.reshape(rows, -1))
        assert float(effort.astype(float) @ scores[:, joint]) == pytest.approx(float(whitened @ against), rel=1e-6)


ONE_FRICTION = {"coulomb_friction", "asymmetric_friction"}
"""Where the disturbances' mean is a small load, both are equal."""


def friction_levels(found: Choice) -> list[float]:
    """Coulomb friction [N], one or both ways."""
    (friction,) = [setting for setting in found.best.settings if setting.name in ONE_FRICTION]
    return [value for key, value in friction.parameters.items() if key.startswith("Fc")]


def names(found: Choice) -> set[str]:
    return {setting.name for setting in found.best.settings}


@pytest.mark.nightly
def test_a_wave_a_twentieth_as_large_as_the_friction_beside_it_is_found() -> None:
    found = choose_effects(residuals_of(MACHINE, carried(lambda x: 1.5 * np.cos(150.0 * x + 0.4), friction_N=30.0)))
    assert len(found.best.settings) == 2
    assert names(found) - ONE_FRICTION == {"cogging"}
    assert friction_levels(found) == pytest.approx([30.0] * len(friction_levels(found)), rel=0.06)
    (wave,) = [setting for setting in found.best.settings if setting.name == "cogging"]
    assert wave.parameters["A1"] == pytest.approx(1.5, rel=0.15)


@pytest.mark.nightly
def test_friction_a_twentieth_off_the_law_is_one_friction() -> None:
    """It is 5 % more at one end of the rail and 5 % less at the other."""
    found = choose_effects(residuals_of(MACHINE, bent()))
    assert len(found.best.settings) == 1
    assert names(found) <= ONE_FRICTION
    assert friction_levels(found) == pytest.approx([30.0] * len(friction_levels(found)), rel=0.06)


def bent() -> dict[str, Recording]:
    """Repeats with a friction whose level depends on the position: the same as a further force on it, sampled as it moves."""
    found = {}
    for experiment in range(2):
        wanted = reference(DURATION_s, experiment)
        rates = np.gradient(wanted) * RATE_Hz
        bend = 30.0 * 0.05 * wanted / np.abs(wanted).max() * np.sign(rates)
        for repeat in range(REPEATS):
            seed = 10 * experiment + repeat
            position, command = run(wanted, coulomb_N=30.0, force_N=disturbance(len(wanted), 3.0, seed) - bend, noise_seed=seed)
            found[f"run_{experiment}_{repeat}"] = recording(wanted, position, command)
    return found
