"""The experiment that tells two sets of effects apart: within limits, written to a file, and as good as predicted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pushed_mass import NOISE, RAIL, recorded

from hil.diagnosis.model_choice.fitting import fit
from hil.diagnosis.next_experiment.proposal import Proposal, propose
from hil.diagnosis.next_experiment.separation import Model, Separation
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.residuals import residuals_of
from hil.diagnosis.retuning.linear_model import linear_at, nominal_offset
from hil.experiments import Jog, JogOnly, Plan, Scan, experiment_from_text
from hil.experiments.file_text import experiment_text
from hil.machine import load_machine
from virtual_bus.plant.parameters import plant_parameters
from virtual_bus.settings import EffectSetting

CHANNELS = ("position_carriage",)
VISCOUS, QUADRATIC = 8.0, 60.0  # N s/m and N s^2/m^2: alike near 0.13 m/s
LEVELS = Levels(np.array([0.05]), 1.0, np.array([NOISE[1], NOISE[0]]))
VALUES = np.array([parameter.value for parameter in plant_parameters(RAIL.plant)])


def model(name: str, share: float = 0.5, **parameters: float) -> Model:
    return Model(VALUES, np.zeros(0), (EffectSetting(name, "carriage", parameters),), share)


@pytest.fixture(scope="module")
def rivals() -> list[Model]:
    return [model("quadratic_friction", Fv2=QUADRATIC), model("viscous_friction", Fv=VISCOUS)]


@pytest.fixture(scope="module")
def told() -> list[float]:
    """How far the search said it was."""
    return []


@pytest.fixture(scope="module")
def proposal(rivals: list[Model], told: list[float]) -> Proposal:
    found = propose(RAIL, rivals, LEVELS, CHANNELS, report=told.append)
    assert found is not None
    return found


def slow_jog() -> Plan:
    (plan,) = JogOnly(pose={"carriage": 0.1}, jog=Jog(0.04, line=2), period_s=4.0, periods=2).plans(RAIL)
    return plan


def test_it_separates_better_than_a_slow_jog(proposal: Proposal, rivals: list[Model]) -> None:
    apart = Separation(RAIL, rivals, LEVELS, CHANNELS)
    (plan,) = proposal.experiment.plans(RAIL)
    near, far = (apart.of_plan(each) for each in (slow_jog(), plan))
    assert np.array_equal(far, proposal.separations)
    assert far[0, 0] > near[0, 0] > 5.0
    assert np.all(far >= near)


def test_a_law_is_told_from_its_special_case_only_where_the_law_is_right() -> None:
    """Friction that differs by direction follows friction that does not; the other way it leaves the difference."""
    coulomb = model("coulomb_friction", Fc=3.0)
    either_way = model("asymmetric_friction", Fc_plus=3.6, Fc_minus=2.4, Fv_plus=0.0, Fv_minus=0.0)
    ((if_special, if_law),) = Separation(RAIL, [coulomb, either_way], LEVELS, CHANNELS).of_plan(slow_jog())
    assert if_special < 0.1 * if_law


def test_a_run_on_another_simulation_confirms_the_prediction(rivals: list[Model]) -> None:
    """Euler steps in their own loop, with noise: what the rival leaves more than the right set, fitted, is d^2 as predicted."""
    plan = slow_jog()
    ((predicted, _),) = Separation(RAIL, rivals, LEVELS, CHANNELS).of_plan(plan)
    one = recorded(plan.reference[:, 0], lambda time, position, speed: -QUADRATIC * speed * abs(speed), 1, excitation=plan.excitation[:, 0])
    trajectories = residuals_of(RAIL, {"run": one}).trajectories
    offset = nominal_offset(trajectories)
    right, other = rivals
    linear = linear_at(trajectories, LEVELS, offset, right.effects)
    own, its = (fit(linear, each.effects, offset) for each in (right, other))
    assert own is not None
    assert its is not None
    assert np.sqrt(max(its.cost() - own.cost(), 0.0)) == pytest.approx(predicted, rel=0.5, abs=2.0)


def test_the_search_says_how_far_it_is(proposal: Proposal, told: list[float]) -> None:
    assert proposal.separations.shape == (1, 2)
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)


def test_its_file_is_an_experiment_within_the_machines_limits(proposal: Proposal) -> None:
    text = proposal.header() + experiment_text(proposal.experiment, RAIL)
    assert f"from viscous_friction at carriage: {proposal.separations[0, 0]:.3g} where quadratic_friction at carriage is right" in text
    (plan,) = experiment_from_text(text, RAIL).plans(RAIL)  # refuses what breaks a limit
    assert plan.rows == pytest.approx(proposal.seconds * RAIL.sample_rate_Hz)


def test_a_machine_that_cannot_be_run_gets_no_experiment(rivals: list[Model]) -> None:
    assert propose(load_machine("silverbox"), rivals, LEVELS, CHANNELS) is None


def test_a_plan_without_motion_separates_nothing() -> None:
    same = [model("viscous_friction", Fv=VISCOUS), model("viscous_friction", Fv=VISCOUS)]
    (plan,) = Scan(axis="carriage", start=0.05, stop=0.15, speed=0.1, acceleration=1.0, sweeps=2).plans(RAIL)
    assert np.all(Separation(RAIL, same, LEVELS, CHANNELS).of_plan(plan) < 0.1)


@pytest.mark.parametrize(
    ("separations", "sentence"),
    [
        ([[0.3, 22.4], [5.0, 1.0]], "next.toml would tell them apart, by 22.4 and 5 standard deviations in 24 s"),
        (
            [[0.3, 0.4], [5.0, 1.0]],
            "next.toml would tell no effect from viscous_friction at carriage and not from the rest, by 0.4 and 5 standard"
            " deviations in 24 s",
        ),
        (
            [[0.3, 0.4], [1.9, 1.0]],
            "no experiment was found that tells them apart; the best one, next.toml, would separate them by 0.4 and 1.9"
            " standard deviations in 24 s",
        ),
    ],
)
def test_an_experiment_that_separates_little_is_not_said_to_tell_sets_apart(
    proposal: Proposal, rivals: list[Model], separations: list[list[float]], sentence: str
) -> None:
    models = (replace(rivals[0], effects=()), *rivals)
    assert replace(proposal, models=models, separations=np.array(separations), seconds=24.0).said(str(Path("next.toml"))) == sentence
