"""Re-tuning, against a carriage whose numbers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from carriage import DAMPING, GAIN, MACHINE, MASS_kg, repeats

from hil.diagnosis.residuals.mismatch import mismatch
from hil.diagnosis.tuning.free_run import TRAIN, FreeRuns, Trial
from hil.diagnosis.tuning.projection import Projection
from hil.diagnosis.tuning.retune import PRIOR, Tuning, descend, linearised, retune
from virtual_bus.plant.parameters import PlantParameter


@pytest.fixture(scope="module")
def runs():
    found = mismatch(MACHINE, repeats(4, mass=1.08 * MASS_kg, damping=0.94 * DAMPING))
    return FreeRuns({TRAIN: found}, found.noise)


def test_numbers_of_the_truth_are_within_their_intervals(runs):
    tuning = retune(runs)
    # mass, damping and gain only show in their ratios: what is certain is mass over gain and damping over gain
    values = dict(zip(tuning.names, tuning.at(tuning.offset)[tuning.indices], strict=True))
    assert values["carriage.mass"] / values["carriage.constant"] == pytest.approx(1.08 * MASS_kg / GAIN, rel=3e-3)
    assert values["carriage.damping"] / values["carriage.constant"] == pytest.approx(0.94 * DAMPING / GAIN, rel=0.02)
    truth = {"carriage.mass": 1.08 * MASS_kg, "carriage.damping": 0.94 * DAMPING, "carriage.constant": GAIN}
    for k, name in enumerate(tuning.names):
        spread = np.sqrt(tuning.covariance[k, k]) * tuning.scale[k]
        assert abs(values[name] - truth[name]) < 3.0 * spread, name


def test_scaling_all_numbers_alike_changes_nothing_and_sensitivities_say_so(runs):
    tuning = linearised(runs, retune(runs))
    alike = tuning.at(tuning.offset)[tuning.indices] / tuning.scale  # a force's gain, what it moves and what slows it
    change = tuning.jacobian @ alike / np.linalg.norm(alike)
    assert np.linalg.norm(tuning.jacobian, axis=0).min() > 40.0
    assert np.linalg.norm(change) < 5e-3


def test_what_is_left_is_noise(runs):
    tuning = retune(runs)
    left = runs.measured() - tuning.predicted
    assert 0.8 < np.mean(left**2) < 1.2


@pytest.mark.filterwarnings("error")
def test_a_run_that_diverges_is_refused_before_its_numbers_overflow(runs, monkeypatch):
    count = len(runs.sets[TRAIN].groups[0].time_s)
    diverged = np.geomspace(1.0, 1e307, count)[:, None] * np.ones(len(runs.sets[TRAIN].channels))
    monkeypatch.setattr("hil.diagnosis.tuning.free_run.simulated_matrix", lambda machine, outputs, channels: diverged)
    assert runs.run_one(Trial(runs.nominal)) is None


def test_a_coarse_encoder_hides_no_sensitivity():
    """Those of a machine that reads no finer than a millimetre are those of the fine one, in units of the same noise."""
    plant = MACHINE.plant
    coarse = replace(MACHINE, plant=replace(plant, encoders=tuple(replace(e, resolution=1e-3) for e in plant.encoders)))
    recorded = repeats(3, duration_s=1.0)
    found = mismatch(coarse, recorded)
    fine = mismatch(MACHINE, recorded, channels=found.channels, noise=found.noise)
    one, other = (retune(FreeRuns({TRAIN: each}, found.noise)).jacobian for each in (found, fine))
    assert (np.linalg.norm(other, axis=0) > 0.5).all()
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_nothing_that_retuning_imitates_is_left_after_projection(runs):
    tuning = retune(runs)
    projection = Projection.of(tuning)
    column = tuning.jacobian[:, 0]
    left = projection.left(column)
    assert left @ left < 1.01  # the prior's own unit
    other = np.random.default_rng(0).standard_normal(len(column))
    weights = np.linalg.solve(tuning.jacobian.T @ tuning.jacobian + np.eye(tuning.jacobian.shape[1]), tuning.jacobian.T @ other)
    expected = np.sum((other - tuning.jacobian @ weights) ** 2) + np.sum(weights**2)
    assert projection.left(other) @ projection.left(other) == pytest.approx(expected)


class Valley:
    """Two numbers that move along a parabola easily and across it hardly, as a light mode makes of masses and springs."""

    def __init__(self, steep: float, along: float) -> None:
        self.steep, self.along = steep, along

    def run(self, trials, name=TRAIN):
        return [self.run_one(trial) for trial in trials]

    def run_one(self, trial, name=TRAIN):
        x, y = (trial.values - 1.0) / PRIOR
        return np.array([self.steep * (y - 0.5 * x**2), self.along * x])


@pytest.mark.parametrize(("steep", "along"), [(1e3, 10.0), (1e4, 30.0)])
def test_a_narrow_valley_that_bends_is_followed_to_its_end(steep, along):
    valley, start = Valley(steep, along), np.ones(2)
    numbers = tuple(PlantParameter(owner, "stiffness", "Nm/rad", 1.0) for owner in ("one", "other"))
    measured, predicted = np.array([0.0, along]), valley.run_one(Trial(start))
    tuning = Tuning(numbers, np.arange(2), np.full(2, PRIOR), np.zeros(2), start, predicted, np.zeros((2, 2)), np.eye(2))
    found = descend(valley, linearised(valley, tuning), measured)
    least = scipy.optimize.minimize_scalar(lambda x: along**2 * (x - 1.0) ** 2 + x**2 + 0.25 * x**4)  # on the valley's floor
    cost = np.sum((measured - found.predicted) ** 2) + found.offset @ found.offset
    assert cost < least.fun + 0.2  # from along**2


class Ringing:
    """A large motion that one number decides, not in proportion to it, and a ringing beside it of which another decides the frequency."""

    parameters = tuple(PlantParameter(owner, "stiffness", "Nm/rad", 1.0) for owner in ("motion", "ringing"))
    nominal = np.ones(2)

    def __init__(self, motion: float, ringing: float) -> None:
        self.true = 1.0 + PRIOR * np.array([motion, ringing])

    def correct(self, trial):
        pass

    def measured(self):
        return self.run_one(Trial(self.true))

    def run(self, trials, name=TRAIN):
        return [self.run_one(trial) for trial in trials]

    def run_one(self, trial, name=TRAIN):
        x, y = (trial.values - 1.0) / PRIOR
        time_s, turn = np.linspace(0.0, 10.0, 400), 2.0 * np.pi
        motion = 3e3 * (x - 0.5 * x**2) * np.sin(turn * 0.4 * time_s * (1.0 - 0.075 * x))
        return motion + 12.0 * np.cos(turn * 3.0 * time_s * (1.0 + 0.1 * y))


@pytest.mark.parametrize(("motion", "ringing"), [(-0.7, -0.06), (-0.7, 0.06), (-0.9, 0.04)])
def test_what_hardly_shows_beside_gross_motion_is_not_carried_into_another_valley(motion, ringing):
    runs = Ringing(motion, ringing)
    tuning = retune(runs)
    assert tuning.offset == pytest.approx([motion, ringing], abs=2e-3)
