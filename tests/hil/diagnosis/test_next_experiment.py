"""The experiment that tells two hypotheses apart: within limits, written to a file, and as good as predicted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pushed_mass import NOISE, RAIL, pushed_mass

from hil.diagnosis.judging.errors_of_laws import temperature
from hil.diagnosis.residuals.noise import assumed_noise
from hil.diagnosis.separating.experiment_families import requests
from hil.diagnosis.separating.next_experiment import DRAWS, REFINEMENTS, REFITTED, propose
from hil.diagnosis.separating.separation import EFFECT_STEP, ROUNDS, Model, Separation
from hil.diagnosis.tuning.retune import tunable
from hil.experiments import Jog, JogOnly, Scan, experiment_from_text
from hil.experiments.file_text import experiment_text
from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.plant.compiled import compile_plant
from virtual_bus.settings import EffectSetting

CHANNELS = ("command_carriage", "position_carriage")
EVEN = (0.5, 0.5)
VISCOUS, QUADRATIC = 8.0, 60.0  # N s/m and N s^2/m^2: alike near 0.13 m/s


def model(name: str, parameter: str, value: float) -> Model:
    plant = compile_plant(RAIL.plant)
    indices = tunable(plant.parameters)
    effect = EffectSetting(name, "carriage", {parameter: value})
    return Model(plant.nominal, (effect,), indices, 0.1 * np.abs(plant.nominal[indices]), ((0, parameter),), f"{name} at carriage")


@pytest.fixture(scope="module")
def rivals():
    return [model("quadratic_friction", "Fv2", QUADRATIC), model("viscous_friction", "Fv", VISCOUS)]


@pytest.fixture(scope="module")
def noise():
    return assumed_noise([NOISE * np.random.default_rng(0).standard_normal((4000, 2))], CHANNELS, RAIL)


@pytest.fixture(scope="module")
def told():
    """How far the search said it was."""
    return []


@pytest.fixture(scope="module")
def proposal(rivals, noise, told):
    return propose(RAIL, rivals, EVEN, noise, CHANNELS, report=told.append)


def drag(time: float, position: float, speed: float) -> float:
    return -QUADRATIC * speed * abs(speed)


def slow_jog():
    (plan,) = JogOnly(pose={"carriage": 0.1}, jog=Jog(0.04, line=2), period_s=4.0, periods=2).plans(RAIL)
    return plan


@pytest.mark.slow
def test_it_separates_better_than_a_slow_jog(proposal, rivals, noise):
    """In units of what an equation may err: a share of what it explains."""
    apart = Separation(RAIL, rivals, noise, CHANNELS)
    (plan,) = proposal.experiment.plans(RAIL)
    near, far = (apart.of_plan(each) for each in (slow_jog(), plan))
    assert np.array_equal(far.separations, proposal.separations)
    assert far.separations[0, 0] ** 2 / temperature(far.removed, 0.0) > near.separations[0, 0] ** 2 / temperature(near.removed, 0.0)


def test_no_separation_exceeds_its_bound_and_processes_change_nothing(rivals, noise):
    plans = [slow_jog(), *Scan(axis="carriage", start=0.05, stop=0.15, speed=0.1, acceleration=1.0, sweeps=2).plans(RAIL)]
    with Separation(RAIL, rivals, noise, CHANNELS, jobs=2) as apart:
        separations = [apart.of_plan(plan) for plan in plans]
        for d, most in zip(separations, apart.at_most(plans), strict=True):
            assert np.all((d.separations > 0.0) & (d.separations <= most.separations)) and d.removed <= most.removed
    alone = Separation(RAIL, rivals, noise, CHANNELS)
    for d, plan in zip(separations, plans, strict=True):
        assert np.array_equal(alone.of_plan(plan).separations, d.separations)


def test_a_law_is_told_from_its_special_case_only_where_the_law_is_right(rivals, noise):
    """Friction that differs by direction follows friction that does not; the other way it leaves the difference."""
    coulomb = model("coulomb_friction", "Fc", 3.0)
    names = ("Fc_plus", "Fc_minus", "Fv_plus", "Fv_minus")
    values = (EffectSetting("asymmetric_friction", "carriage", dict(zip(names, (3.2, 2.8, 0.0, 0.0), strict=True))),)
    either_way = replace(coulomb, effects=values, free=tuple((0, name) for name in names))
    ((if_special, if_law),) = Separation(RAIL, [coulomb, either_way], noise, CHANNELS).of_plan(slow_jog()).separations
    assert if_special < 0.1 * if_law


@pytest.mark.parametrize("order", [0.5, 4.0, 400.0])
def test_an_order_is_moved_by_a_share_of_itself_however_far_it_may_reach(order):
    """A thousandth of that is 100 radians per metre: a change of a slow wave for another one."""
    wavy = model("transmission_error", "k", order)
    ((moved, step),) = wavy.effect_moves(slow_jog())
    assert moved.effects[0].parameters["k"] == pytest.approx(order * (1.0 + EFFECT_STEP))
    assert wavy.at(np.append(np.zeros(len(wavy.indices)), step)).effects == moved.effects


def test_the_search_says_how_far_it_is_and_refits_few_draws(proposal, told, rivals):
    assert told == sorted(told) and told[-1] == 1.0
    tuned_once, both_ways = 1 + len(rivals[0].indices), 2 * ROUNDS * 2
    assert proposal.runs <= len(requests(RAIL)) * DRAWS * 3 + (REFITTED + REFINEMENTS + 1) * (3 + tuned_once + both_ways)


def test_its_file_is_an_experiment_within_the_machines_limits(proposal):
    text = proposal.header() + experiment_text(proposal.experiment, RAIL)
    assert f"from viscous_friction at carriage: {proposal.separations[0, 0]:.3g} where quadratic_friction at carriage is right" in text
    (plan,) = experiment_from_text(text, RAIL).plans(RAIL)  # refuses what breaks a limit
    assert plan.rows == pytest.approx(proposal.seconds * RAIL.sample_rate_Hz)


def test_a_run_on_another_simulation_confirms_the_prediction(proposal, rivals, noise):
    (plan,) = proposal.experiment.plans(RAIL)
    position, command = pushed_mass(plan.reference[:, 0], drag, excitation=plan.excitation[:, 0])
    measured = np.column_stack([command, position]) + NOISE * np.random.default_rng(1).standard_normal((plan.rows, 2))
    (seen,) = Separation(RAIL, rivals, noise, CHANNELS).of_recording(plan, measured)
    assert 0.5 * proposal.separations[0, 0] < seen < 2.0 * proposal.separations[0, 0]


def test_a_machine_that_cannot_be_run_gets_no_experiment(rivals, noise):
    assert propose(load_machine("silverbox"), rivals, EVEN, noise, CHANNELS) is None


@pytest.mark.parametrize(
    ("separations", "sentence"),
    [
        ([[0.3, 22.4], [5.0, 1.0]], "next.toml would tell them apart, by 22.4 and 5 standard deviations in 24 s"),
        ([[0.3, 0.4], [5.0, 1.0]], "next.toml would tell a from c and not from the rest, by 0.4 and 5 standard deviations in 24 s"),
        (
            [[0.3, 0.4], [1.9, 1.0]],
            "no experiment was found that tells them apart; the best one, next.toml, would separate them by 0.4 and 1.9"
            " standard deviations in 24 s",
        ),
    ],
)
def test_an_experiment_that_separates_little_is_not_said_to_tell_hypotheses_apart(proposal, rivals, separations, sentence):
    models = tuple(replace(rivals[0], name=name) for name in "abc")
    assert replace(proposal, models=models, separations=np.array(separations), seconds=24.0).said("next.toml") == sentence


PLAIN = Simulator(smooth(RAIL))


def answer(of: Model, noise, plan) -> np.ndarray:
    """Whitened rows of a model's free run."""
    inputs = Inputs(plan.reference, plan.excitation, np.zeros_like(plan.reference), None, plan.start_pose)
    outputs = PLAIN.run(inputs, of.values, of.effects)
    settled = plan.metadata["settle_periods"] * plan.metadata["period_samples"]
    return noise.of_mean(1).whiten(simulated_matrix(RAIL, outputs, CHANNELS)[settled:])


def with_number(of: Model, quantity: str, value: float) -> Model:
    (number,) = (k for k, p in enumerate(compile_plant(RAIL.plant).parameters) if p.quantity == quantity)
    values = of.values.copy()
    values[number] = value
    return replace(of, values=values)


def with_tuned(of: Model, **priors: float) -> Model:
    """With these numbers tuned, one unit of the prior each, and nothing of its effects."""
    quantities = [p.quantity for p in compile_plant(RAIL.plant).parameters]
    indices = np.array([quantities.index(name) for name in priors], dtype=int)
    return replace(of, indices=indices, scale=np.array(list(priors.values())), free=())


@pytest.mark.slow
def test_a_refit_of_several_rounds_pays_for_the_way_it_goes(noise):
    """A mass a fifth too large, two of its priors: the least distance of a fine scan of it."""
    plan, priors = slow_jog(), np.linspace(-3.0, 0.0, 61)
    light = with_number(with_tuned(model("quadratic_friction", "Fv2", 5.0), mass=2.0), "mass", 16.0)
    rival = with_tuned(model("viscous_friction", "Fv", 0.5), mass=2.0)
    target = answer(light, noise, plan)
    answers = [answer(with_number(rival, "mass", 20.0 + 2.0 * p), noise, plan) for p in priors]
    scanned = [np.hypot(np.linalg.norm(target - other), p) for p, other in zip(priors, answers, strict=True)]
    assert priors[int(np.argmin(scanned))] == pytest.approx(-2.0, abs=0.1)
    assert Separation(RAIL, [light, rival], noise, CHANNELS).of_plan(plan).separations[0, 0] == pytest.approx(min(scanned), rel=0.01)


def test_a_refit_leaves_what_a_parameter_may_not_be(noise):
    """Viscous friction follows a damper that is too strong, but not one that is too weak: it pushes nothing."""
    plan = slow_jog()
    weak = with_number(with_tuned(model("coulomb_friction", "Fc", 0.5)), "damping", 50.0)
    rival = model("viscous_friction", "Fv", 4.0)
    least = np.linalg.norm(answer(weak, noise, plan) - answer(replace(rival, effects=()), noise, plan))
    untuned = replace(with_tuned(rival), free=rival.free)
    assert Separation(RAIL, [weak, untuned], noise, CHANNELS).of_plan(plan).separations[0, 0] == pytest.approx(least, rel=0.01)
