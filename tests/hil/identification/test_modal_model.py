"""Claims of the parametric modal model over poses, held against a loop whose two modes are known at every pose."""

from __future__ import annotations

import io
from dataclasses import replace

import control
import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, Loop, experiment, plant_response, two_mode_loop

from hil.figures.modes import modes_figure
from hil.identification import FrequencyResponse, IdentificationError, ModalFrfModel, periodic_records, robust_bla
from hil.identification.modal.all_poses import JointProblem
from hil.identification.modal.lpv_model import fit_modal_model
from hil.identification.modal.one_pose import choose_pairs
from hil.identification.modal.pole_blocks import Block, block_responses

PERIOD, SETTLE, LINES = 512, 4, np.arange(5, 160)
DAMPING = (0.03, 0.02)
POSES = np.linspace(-1.0, 1.0, 13)
NAMES = ("imu_x", "position_propeller", "position_roll")


def frequencies_Hz(pose: float) -> tuple[float, float]:
    return 3.0 + 0.5 * pose**2, 7.0 + 0.2 * pose


def loop_at(pose: float) -> Loop:
    return two_mode_loop(frequencies_Hz=frequencies_Hz(pose), damping=DAMPING)


def measured(
    pose: float, rng: np.random.Generator, noise: tuple[float, float, float] = (0.05, 0.005, 0.005), loop: Loop | None = None
) -> FrequencyResponse:
    data = experiment(loop or loop_at(pose), rng, realisations=3, periods=4, settle_periods=SETTLE, period=PERIOD, lines=LINES, noise=noise)
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
def responses() -> list[FrequencyResponse]:
    rng = np.random.default_rng(50)
    return [measured(pose, rng) for pose in POSES]


@pytest.fixture(scope="module")
def model(responses: list[FrequencyResponse]) -> ModalFrfModel:
    return fit_modal_model(responses[::2], 1)


@pytest.mark.parametrize("wrong", [-0.5, 0.5], ids=["no vibration", "too fast"])
def test_poles_that_cannot_be_a_start_are_one_line(responses: list[FrequencyResponse], wrong: float) -> None:
    problem = JointProblem(responses[:3], np.array([[-1.0], [0.0], [1.0]]))
    scale = 20.0 if wrong < 0.0 else 1e6
    start = [Block(scale, (np.array([wrong]), np.array([0.1])), flexible=False, is_mode=True)]
    with pytest.raises(IdentificationError, match=r"the poles near .* Hz are not followed over the poses by polynomials of order 0"):
        problem.fit(start, (0,) * problem.elements)
    with pytest.raises(IdentificationError, match="take more poses"):
        problem.numerator_orders(start, 1)


def test_the_number_of_modes_is_found(responses: list[FrequencyResponse]) -> None:
    fit = choose_pairs(responses[6])
    assert len(fit.a0) == 2
    np.testing.assert_allclose(np.sqrt(fit.a0) / (2 * np.pi), frequencies_Hz(0.0), rtol=1e-3)


@pytest.mark.slow
def test_poles_at_poses_held_out_are_foretold(model: ModalFrfModel) -> None:
    for pose in POSES[1::2]:
        found_Hz, found_damping, _, _ = model.modes(pose)
        np.testing.assert_allclose(found_Hz, frequencies_Hz(pose), rtol=0.01)
        np.testing.assert_allclose(found_damping, DAMPING, rtol=0.1)


def test_responses_at_poses_held_out_err_less_than_the_measurement(model: ModalFrfModel, responses: list[FrequencyResponse]) -> None:
    below = []
    for response, pose in zip(responses[1::2], POSES[1::2], strict=True):
        truth = plant_response(loop_at(pose), response.frequencies_Hz)
        below.append(np.abs(model.response(pose, response.frequencies_Hz) - truth) <= response.bound(0.95, "noise"))
    assert np.mean(below) >= 0.95


@pytest.mark.nightly
def test_confidence_intervals_hold_what_they_promise() -> None:
    """At the poses fitted and between, over several fits."""
    inside = []
    for seed in range(3):
        rng = np.random.default_rng(60 + seed)
        made = fit_modal_model([measured(pose, rng) for pose in POSES[::2]], 1)
        for pose in (-1.0, -0.5, 0.1, 0.5, 0.9):
            found_Hz, damping, half_Hz, half_damping = made.modes(pose)
            inside += [*(np.abs(found_Hz - frequencies_Hz(pose)) <= half_Hz), *(np.abs(damping - DAMPING) <= half_damping)]
    assert 0.85 <= np.mean(inside) <= 1.0


def test_the_state_space_model_is_the_response_before_hold_and_tick(model: ModalFrfModel) -> None:
    """python-control's own discretisation and evaluation, a tick of delay added, against the model's response."""
    pose, at_Hz = 0.25, np.array([1.0, 3.1, 5.0, 7.0, 12.0])
    sampled = control.c2d(model.state_space(pose), 1.0 / SAMPLE_RATE_HZ, "zoh")
    z = np.exp(2j * np.pi * at_Hz / SAMPLE_RATE_HZ)
    expected = np.stack([sampled(value) / value for value in z])
    found = model.response(pose, at_Hz)
    assert sampled.nstates == 4
    assert np.max(np.abs(found - expected) / np.abs(expected).max(axis=0)) < 0.02  # modes of rank one where the fit is free


def test_a_block_is_sampled_as_python_control_samples_it() -> None:
    """Vibrating, repelled by gravity, and two pairs as one block of fourth order."""
    at_Hz = np.array([0.5, 3.0, 20.0])
    z = np.exp(2j * np.pi * at_Hz / SAMPLE_RATE_HZ)
    for denominator in ([1.0, 0.8, 400.0], [1.0, 0.1, -3.0], np.polymul([1.0, 0.2, 1.0], [1.0, 0.1, -0.5])):
        order = len(denominator) - 1
        found = block_responses(np.array(denominator[:0:-1]), at_Hz, SAMPLE_RATE_HZ)
        for power in range(order):
            sampled = control.c2d(control.ss(control.tf([1.0] + [0.0] * power, denominator)), 1.0 / SAMPLE_RATE_HZ, "zoh")
            np.testing.assert_allclose(found[:, power], sampled(z) / z, rtol=1e-7)


def test_stability_and_passivity_are_told(model: ModalFrfModel) -> None:
    assert model.is_stable(0.0)
    # modal input [[1, 0.4], [-0.3, 0.9]], modal output [[1, 0.3], [0.4, 1]]: only mode 2 at the propeller is driven against its sense
    np.testing.assert_array_equal(model.passive_modes(0.0), [[True, True], [False, True]])


@pytest.mark.slow
def test_the_order_over_the_poses_is_the_datas_own() -> None:
    """Of a machine whose first mode alone moves, along 1 / omega^2 = quadratic in the pose."""
    rng = np.random.default_rng(70)
    poses = np.linspace(-1.0, 1.0, 9)
    made = [
        measured(pose, rng, loop=two_mode_loop(frequencies_Hz=(3.0 / np.sqrt(1.0 - 0.2 * pose**2), 7.0), damping=DAMPING)) for pose in poses
    ]
    first, second = (block for block in fit_modal_model(made, 1).fit.blocks if block.is_mode)
    assert len(first.coefficients[1]) == 3
    assert len(second.coefficients[1]) == 1
    assert len(second.coefficients[0]) == 1


@pytest.mark.slow
def test_poles_below_the_band_do_not_bend_the_response_within_it() -> None:
    """A rigid body's slow pair below the lowest line, moving over the poses and repelled by gravity at some of them."""
    rng = np.random.default_rng(71)
    at_Hz = LINES * SAMPLE_RATE_HZ / PERIOD
    z = np.exp(2j * np.pi * at_Hz / SAMPLE_RATE_HZ)

    def truth(pose: float) -> np.ndarray:
        """Two modes and two rigid bodies, sampled by python-control."""
        G = np.zeros((len(z), 3, 2), complex)
        modes = (((2 * np.pi * 3.0) ** 2 / (1.0 + 0.1 * pose), 0.5), ((2 * np.pi * 7.0) ** 2, 1.0))
        rigid = ((0.8 * pose, 0.1), (0.5 - 0.4 * pose, 0.05))
        for k, (stiffness, damping) in enumerate((*modes, *rigid)):
            sampled = control.c2d(control.tf([1.0], [1.0, damping, stiffness]), 1.0 / SAMPLE_RATE_HZ, "zoh")
            shape = np.outer([0.3, 1.0 - k / 3, 0.2 + k / 3], [1.0, (-1.0) ** k * (1.0 + 0.3 * pose)])
            G += (sampled(z) / z)[:, None, None] * shape
        return G

    template = measured(0.0, rng)
    deviation = 1e-5 * np.ones((len(z), 3, 2))

    def response_at(pose: float) -> FrequencyResponse:
        noise = (rng.standard_normal((len(z), 3, 2)) + 1j * rng.standard_normal((len(z), 3, 2))) * deviation / np.sqrt(2.0)
        covariance = np.broadcast_to(np.eye(6) * deviation.flat[0] ** 2, (len(z), 6, 6)).astype(complex)
        return replace(template, G=truth(pose) + noise, noise_covariance=covariance, total_covariance=covariance, pose=(0.0, pose))

    model = fit_modal_model([response_at(pose) for pose in POSES[::2]], 1)
    error = np.stack([np.abs(model.response(pose, at_Hz) - truth(pose)) for pose in POSES[1::2]])
    assert len(model.modes(0.0)[0]) == 2
    assert np.mean(error <= np.sqrt(-np.log(0.05)) * deviation) >= 0.95


def test_poses_outside_the_fit_and_too_few_are_refused(model: ModalFrfModel, responses: list[FrequencyResponse]) -> None:
    with pytest.raises(IdentificationError, match=r"pose 1\.5 is outside -1 to 1"):
        model.response(1.5, np.array([1.0]))
    with pytest.raises(IdentificationError, match="2 poses: a model over the pose takes three or more"):
        fit_modal_model(responses[:2], 1)


def test_the_figure_draws_every_mode_with_units(model: ModalFrfModel) -> None:
    figure = modes_figure(model)
    figure.savefig(io.BytesIO(), dpi=40)
    assert [axes.get_ylabel() for axes in figure.axes] == ["natural frequency [Hz]", "damping ratio [%]"]
    assert len(figure.axes[0].get_legend().get_texts()) == 2
