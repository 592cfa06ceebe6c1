"""Claims of the parametric modal model over poses, held against a loop whose two modes are known at every pose."""

import io

import control
import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, experiment, plant_response, two_mode_loop

from hil.figures.modes import modes_figure
from hil.identification import IdentificationError, periodic_records, robust_bla
from hil.identification.modal_model import fit_modal_model, smooth
from hil.identification.modal_pose import choose_pairs, pair_responses

PERIOD, SETTLE, LINES = 512, 4, np.arange(5, 160)
DAMPING = (0.03, 0.02)
POSES = np.linspace(-1.0, 1.0, 13)
NAMES = ("imu_x", "position_propeller", "position_roll")


def frequencies_Hz(pose):
    return 3.0 + 0.5 * pose**2, 7.0 + 0.2 * pose


def loop_at(pose):
    return two_mode_loop(frequencies_Hz=frequencies_Hz(pose), damping=DAMPING)


def measured(pose, rng, noise=(0.05, 0.005, 0.005)):
    data = experiment(loop_at(pose), rng, realisations=3, periods=4, settle_periods=SETTLE, period=PERIOD, lines=LINES, noise=noise)
    records = periodic_records(
        **data,
        period_samples=PERIOD,
        sample_rate_Hz=SAMPLE_RATE_HZ,
        settle_periods=SETTLE,
        output_names=NAMES,
        input_names=("command_propeller", "command_roll"),
        pose=(0.0, pose),
    )
    return robust_bla(records)


@pytest.fixture(scope="module")
def responses():
    rng = np.random.default_rng(50)
    return [measured(pose, rng) for pose in POSES]


@pytest.fixture(scope="module")
def model(responses):
    return fit_modal_model(responses[::2], 1)


def test_the_number_of_modes_is_found(responses):
    fit = choose_pairs(responses[6])
    assert len(fit.a0) == 2
    np.testing.assert_allclose(np.sqrt(fit.a0) / (2 * np.pi), frequencies_Hz(0.0), rtol=1e-3)


def test_poles_at_poses_held_out_are_foretold(model):
    for pose in POSES[1::2]:
        found_Hz, found_damping, _, _ = model.modes(pose)
        np.testing.assert_allclose(found_Hz, frequencies_Hz(pose), rtol=0.01)
        np.testing.assert_allclose(found_damping, DAMPING, rtol=0.1)


def test_responses_at_poses_held_out_err_less_than_the_measurement(model, responses):
    below = []
    for response, pose in zip(responses[1::2], POSES[1::2], strict=True):
        truth = plant_response(loop_at(pose), response.frequencies_Hz)
        below.append(np.abs(model.response(pose, response.frequencies_Hz) - truth) <= response.bound(0.95, "noise"))
    assert np.mean(below) >= 0.95


def test_confidence_intervals_hold_what_they_promise():
    """At the poses fitted and between, over several fits."""
    inside = []
    for seed in range(3):
        rng = np.random.default_rng(60 + seed)
        made = fit_modal_model([measured(pose, rng) for pose in POSES[::2]], 1)
        for pose in (-1.0, -0.5, 0.1, 0.5, 0.9):
            found_Hz, damping, half_Hz, half_damping = made.modes(pose)
            inside += [*(np.abs(found_Hz - frequencies_Hz(pose)) <= half_Hz), *(np.abs(damping - DAMPING) <= half_damping)]
    assert 0.85 <= np.mean(inside) <= 1.0


def test_the_state_space_model_is_the_response_before_hold_and_tick(model):
    """python-control's own discretisation and evaluation, a tick of delay added, against the model's response."""
    pose, at_Hz = 0.25, np.array([1.0, 3.1, 5.0, 7.0, 12.0])
    sampled = control.c2d(model.state_space(pose), 1.0 / SAMPLE_RATE_HZ, "zoh")
    z = np.exp(2j * np.pi * at_Hz / SAMPLE_RATE_HZ)
    expected = np.stack([sampled(value) / value for value in z])
    found = model.response(pose, at_Hz)
    assert sampled.nstates == 4
    assert np.max(np.abs(found - expected) / np.abs(expected).max(axis=0)) < 0.02  # modes of rank one where the fit is free


def test_one_pair_is_sampled_as_python_control_samples_it():
    a0, a1 = np.array([400.0, -3.0]), np.array([0.8, 0.1])
    at_Hz = np.array([0.5, 3.0, 20.0])
    z = np.exp(2j * np.pi * at_Hz / SAMPLE_RATE_HZ)
    for k in range(2):
        for power, numerator in enumerate(([1.0], [1.0, 0.0])):
            sampled = control.c2d(control.tf(numerator, [1.0, a1[k], a0[k]]), 1.0 / SAMPLE_RATE_HZ, "zoh")
            np.testing.assert_allclose(pair_responses(a0, a1, at_Hz, SAMPLE_RATE_HZ)[k, :, power], sampled(z) / z, rtol=1e-7)


def test_stability_and_passivity_are_told(model):
    assert model.is_stable(0.0)
    # modal input [[1, 0.4], [-0.3, 0.9]], modal output [[1, 0.3], [0.4, 1]]: only mode 2 at the propeller is driven against its sense
    np.testing.assert_array_equal(model.passive_modes(0.0), [[True, True], [False, True]])


def test_the_order_over_the_poses_is_the_datas_own():
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 25)
    for order in (0, 1, 2, 4):
        truth = np.polynomial.legendre.legval(x, [1.0] * (order + 1))
        assert len(smooth(x, truth + 0.01 * rng.standard_normal(25), np.full(25, 1e-4)).coefficients) == order + 1


def test_poses_outside_the_fit_and_too_few_are_refused(model, responses):
    with pytest.raises(IdentificationError, match=r"pose 1\.5 is outside -1 to 1"):
        model.response(1.5, np.array([1.0]))
    with pytest.raises(IdentificationError, match="2 poses: a model over the pose takes three or more"):
        fit_modal_model(responses[:2], 1)


def test_the_figure_draws_every_mode_with_units(model):
    figure = modes_figure(model, POSES[::2])
    figure.savefig(io.BytesIO(), dpi=40)
    assert [axes.get_ylabel() for axes in figure.axes] == ["natural frequency [Hz]", "damping ratio [%]"]
    assert len(figure.axes[0].get_legend().get_texts()) == 2
