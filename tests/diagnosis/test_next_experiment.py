"""The experiment that tells two hypotheses apart: within limits, written to a file, and as good as predicted."""

from __future__ import annotations

import numpy as np
import pytest
from pushed_mass import NOISE, RAIL, pushed_mass

from hil.diagnosis.experiment_families import requests
from hil.diagnosis.next_experiment import DRAWS, REFINEMENTS, propose
from hil.diagnosis.noise import assumed_noise
from hil.diagnosis.retune import tunable
from hil.diagnosis.separation import Model, Separation
from hil.experiments import Jog, JogOnly, Scan, experiment_from_text
from hil.experiments.file_text import experiment_text
from hil.machine import load_machine
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting

CHANNELS = ("command_carriage", "position_carriage")
VISCOUS, QUADRATIC = 8.0, 60.0  # N s/m and N s^2/m^2: alike near 0.13 m/s


def model(name: str, parameter: str, value: float) -> Model:
    plant = compile_plant(RAIL.plant)
    indices = tunable(plant.parameters)
    effect = EffectSetting(name, "carriage", {parameter: value})
    return Model(plant.nominal, (effect,), indices, 0.1 * np.abs(plant.nominal[indices]), ((0, parameter),))


@pytest.fixture(scope="module")
def rivals():
    return [model("quadratic_friction", "Fv2", QUADRATIC), model("viscous_friction", "Fv", VISCOUS)]


@pytest.fixture(scope="module")
def noise():
    return assumed_noise([NOISE * np.random.default_rng(0).standard_normal((4000, 2))], CHANNELS, RAIL)


@pytest.fixture(scope="module")
def proposal(rivals, noise):
    return propose(RAIL, rivals, noise, CHANNELS)


def drag(time: float, position: float, speed: float) -> float:
    return -QUADRATIC * speed * abs(speed)


def slow_jog():
    (plan,) = JogOnly(pose={"carriage": 0.1}, jog=Jog(0.04, line=2), period_s=4.0, periods=2).plans(RAIL)
    return plan


def test_it_separates_better_than_a_slow_jog(proposal, rivals, noise):
    assert proposal.separation > 5.0 * Separation(RAIL, rivals, noise, CHANNELS).of_plan(slow_jog())


def test_no_separation_exceeds_its_bound_and_processes_change_nothing(rivals, noise):
    plans = [slow_jog(), *Scan(axis="carriage", start=0.05, stop=0.15, speed=0.1, acceleration=1.0, sweeps=2).plans(RAIL)]
    with Separation(RAIL, rivals, noise, CHANNELS, jobs=2) as apart:
        separations = [apart.of_plan(plan) for plan in plans]
        assert all(0.0 < d <= most for d, most in zip(separations, apart.at_most(plans), strict=True))
    alone = Separation(RAIL, rivals, noise, CHANNELS)
    assert [alone.of_plan(plan) for plan in plans] == separations


def test_the_search_says_how_far_it_is_and_skips_what_cannot_be_best(rivals, noise):
    shares = []
    found = propose(RAIL, rivals, noise, CHANNELS, report=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1.0
    runs_of_one = 2 + len(rivals[1].indices) + 1
    assert found.runs < 0.8 * (len(requests(RAIL)) * DRAWS + REFINEMENTS) * runs_of_one


def test_its_file_is_an_experiment_within_the_machines_limits(proposal):
    names = ["quadratic_friction at carriage", "viscous_friction at carriage"]
    text = proposal.header(names) + experiment_text(proposal.experiment, RAIL)
    assert f"Predicted separation: {proposal.separation:.3g} standard deviations" in text
    (plan,) = experiment_from_text(text, RAIL).plans(RAIL)  # refuses what breaks a limit
    assert plan.rows == pytest.approx(proposal.seconds * RAIL.sample_rate_Hz)


def test_a_run_on_another_simulation_confirms_the_prediction(proposal, rivals, noise):
    (plan,) = proposal.experiment.plans(RAIL)
    position, command = pushed_mass(plan.reference[:, 0], drag, excitation=plan.excitation[:, 0])
    measured = np.column_stack([command, position]) + NOISE * np.random.default_rng(1).standard_normal((plan.rows, 2))
    seen = Separation(RAIL, rivals, noise, CHANNELS).of_recording(plan, measured)
    assert 0.5 * proposal.separation < seen < 2.0 * proposal.separation


def test_a_machine_that_cannot_be_run_gets_no_experiment(rivals, noise):
    assert propose(load_machine("silverbox"), rivals, noise, CHANNELS) is None
