"""The parametric modal model over two scheduling parameters, held against a loop whose modes are known at every pose."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import legendre
from simulated_loop import SAMPLE_RATE_HZ, experiment, plant_response, two_mode_loop

from hil.figures.modes import modes_figure
from hil.identification import FrequencyResponse, IdentificationError, ModalFrfModel, fit_modal_model, periodic_records, robust_bla
from hil.identification.modal.pose_basis import over_poses, whole_degrees

PERIOD, SETTLE, LINES = 512, 4, np.arange(5, 160)
DAMPING = (0.03, 0.02)
GRID = [(x, y) for x in (-0.8, -0.4, 0.1, 0.5, 0.8) for y in (-1.0, -0.5, 0.0, 0.6, 1.0)]
BETWEEN = [(-0.6, 0.3), (0.3, -0.7), (0.0, 0.2)]


def frequencies_Hz(x: float, y: float) -> tuple[float, float]:
    """Masses, and so 1 / omega^2, that are polynomials of the pose."""
    return 3.0 / float(np.sqrt(1.0 - 0.1 * y**2 + 0.1 * x * y)), 7.0 / float(np.sqrt(1.0 + 0.06 * y - 0.1 * x))


def measured(pose: tuple[float, float], rng: np.random.Generator) -> FrequencyResponse:
    loop = two_mode_loop(frequencies_Hz=frequencies_Hz(*pose), damping=DAMPING)
    data = experiment(loop, rng, realisations=3, periods=4, settle_periods=SETTLE, period=PERIOD, lines=LINES, noise=(0.5, 0.05, 0.05))
    records = periodic_records(
        **data,
        period_samples=PERIOD,
        sample_rate_Hz=SAMPLE_RATE_HZ,
        settle_periods=SETTLE,
        output_names=("imu_x", "position_propeller", "position_roll"),
        input_names=("command_propeller", "command_roll"),
        pose=pose,
    )
    return robust_bla(records)


@pytest.fixture(scope="module")
def responses() -> list[FrequencyResponse]:
    rng = np.random.default_rng(71)
    return [measured(pose, rng) for pose in GRID]


@pytest.fixture(scope="module")
def model(responses: list[FrequencyResponse]) -> ModalFrfModel:
    return fit_modal_model(responses, (0, 1))


def test_over_one_axis_the_products_are_legendres_polynomials() -> None:
    x = np.linspace(-1.0, 1.0, 9)
    assert np.array_equal(over_poses(x[:, None], 7), legendre.legvander(x, 6))


def test_over_two_axes_they_are_all_products_by_rising_degree() -> None:
    x, y = np.array([[0.3, -0.7], [1.0, 0.1], [-0.2, 0.9]]).T
    expected = [np.ones(3), x, y, 1.5 * x**2 - 0.5, x * y, 1.5 * y**2 - 0.5]
    np.testing.assert_allclose(over_poses(np.stack((x, y), axis=1), 6), np.stack(expected, axis=1), atol=1e-15)
    assert whole_degrees(2, 13) == [0, 2, 5, 9]
    assert whole_degrees(1, 3) == [0, 1, 2, 3]


@pytest.mark.slow
def test_modes_between_the_poses_are_the_machines(model: ModalFrfModel) -> None:
    for pose in BETWEEN:
        found_Hz, damping, half_Hz, half_damping = model.modes(pose)
        np.testing.assert_allclose(found_Hz, frequencies_Hz(*pose), rtol=0.01)
        np.testing.assert_allclose(damping, DAMPING, rtol=0.15)
        assert (half_Hz < 0.05).all()
        assert (half_damping < 0.01).all()


def test_responses_between_the_poses_are_the_machines(model: ModalFrfModel, responses: list[FrequencyResponse]) -> None:
    at_Hz, bound, below = responses[0].frequencies_Hz, responses[5].bound(0.95, "noise"), []
    for pose in BETWEEN:
        truth = plant_response(two_mode_loop(frequencies_Hz=frequencies_Hz(*pose), damping=DAMPING), at_Hz)
        below.append(np.abs(model.response(pose, at_Hz) - truth) <= bound)
    assert np.mean(below) >= 0.95


def test_what_makes_no_model_is_refused(model: ModalFrfModel, responses: list[FrequencyResponse]) -> None:
    with pytest.raises(IdentificationError, match=r"pose 1\.5 is outside -1 to 1"):
        model.modes((0.0, 1.5))
    with pytest.raises(IdentificationError, match="1 numbers, and the model is over 2"):
        model.modes(0.0)
    with pytest.raises(IdentificationError, match="5 poses: a model over two axes takes six or more"):
        fit_modal_model(responses[:5], (0, 1))
    with pytest.raises(IdentificationError, match="the poses lie on one line, or at two levels of an axis"):
        fit_modal_model(responses[:10], (0, 1))
    with pytest.raises(IdentificationError, match="two responses are of one pose"):
        fit_modal_model([*responses, responses[0]], (0, 1))


def test_the_figure_is_a_map_of_every_mode(model: ModalFrfModel) -> None:
    figure = modes_figure(model, title="25 poses", axes_names=("propeller", "roll"))
    labels = {axes.get_ylabel() for axes in figure.axes} | {axes.get_xlabel() for axes in figure.axes}
    assert {"roll [°]", "propeller [°]", "natural frequency [Hz]", "damping ratio [%]"} <= labels
    assert [axes.get_title() for axes in figure.axes[:4]] == ["mode 1", "mode 1", "mode 2", "mode 2"]
