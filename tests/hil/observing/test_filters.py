"""Claims: the filters are the ones of the textbooks, in another arithmetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, FREQUENCIES_Hz, drawn_rows, small_model, small_noise

from controllers.observers.consistency import share_in_band
from controllers.observers.modal_observer import ModalObserver
from controllers.observers.settings import ObserverNoise

filterpy_kalman = pytest.importorskip("filterpy.kalman", reason="filterpy is in the extra `test`")

ROWS = 120


def _linear_reference(
    dense: DenseModel, observer: ModalObserver, noise: ObserverNoise, measured: np.ndarray, commands: np.ndarray
) -> np.ndarray:
    """Filterpy's Kalman filter on the dense model: states (N, states)."""
    states = dense.states
    reference = filterpy_kalman.KalmanFilter(states, 10, 2)
    zero, nothing = np.zeros(states), np.zeros(2)
    offset = dense.transition(zero, nothing)
    reference.F = np.array([dense.transition(unit, nothing) - offset for unit in np.eye(states)]).T
    silent = dense.outputs(zero, nothing)
    reference.H = np.array([dense.outputs(unit, nothing) - silent for unit in np.eye(states)]).T
    reference.Q, reference.R = dense.process_covariance(), np.diag(noise.measurement**2)
    reference.P, reference.x = observer.covariance, zero.copy()
    reference.x[:2] = measured[0, :2]
    reference.x[-len(noise.bias) or states :] = noise.bias
    found = np.zeros((len(measured), states))
    for k, z in enumerate(measured):
        u = commands[max(k - 2, 0)] if k else nothing
        if k:
            reference.predict()
            reference.x = reference.x + dense.transition(zero, u)
        reference.update(z - dense.outputs(zero, u))
        found[k] = reference.x
    return found


@pytest.mark.parametrize("has_places", [False, True])
@pytest.mark.parametrize("kind", ["kf", "ekf", "ukf"])
def test_every_filter_is_filterpys_kalman_filter_on_a_linear_machine(kind: str, has_places: bool) -> None:
    model, noise = small_model(revolute=False, gravity=np.zeros(3)), small_noise()
    if has_places:  # three disturbances, of which one lies in a band and one is a low pass, each pushing axes and modes together
        over_stiffness = np.append([1.0, 1.0], (2.0 * np.pi * FREQUENCIES_Hz) ** -2)[:, None, None]
        model = replace(model, directions=over_stiffness * np.random.default_rng(4).normal(size=(6, 3, 1)))
        time, middle, biases = np.array([0.1, 0.05, 0.2]), np.array([0.0, 4.0, 9.0]), np.full(6, 1e-3)
        noise = replace(noise, disturbance=np.full(3, 0.5), disturbance_time_s=time, disturbance_Hz=middle, bias=biases)
        noise = replace(noise, low_pass=np.array([False, False, True]))
    model.coefficients[[14 * i + j for i in range(4) for j in (9, 10, 11)]] = 0.0  # shapes that do not turn: nothing is tilted
    dense = DenseModel(model, noise)
    measured, commands, _ = drawn_rows(dense, noise, ROWS, seed=1)
    observer = ModalObserver(model, noise, kind)  # type: ignore[arg-type]
    expected = _linear_reference(dense, observer, noise, measured, commands)
    scale = np.abs(expected).max(axis=0)
    for k in range(ROWS):
        observer.step_measured(measured[k], commands[max(k - 1, 0)])
        assert np.abs((observer.state - expected[k]) / np.maximum(scale, 1e-12)).max() < 1e-9, f"row {k}"


def test_the_ukf_is_filterpys_with_equal_weights_on_turning_axes() -> None:
    model, noise = small_model(), small_noise()
    dense = DenseModel(model, noise)
    measured, commands, _ = drawn_rows(dense, noise, 40, seed=2)
    observer = ModalObserver(model, noise, "ukf")
    acting = [np.zeros(2)]
    points = filterpy_kalman.JulierSigmaPoints(dense.states, kappa=0.0)
    reference = filterpy_kalman.UnscentedKalmanFilter(
        dense.states,
        10,
        1.0,
        hx=lambda x: dense.outputs(x, acting[0]),
        fx=lambda x, _: dense.transition(x, acting[0]),
        points=points,
    )
    reference.Q, reference.R = dense.process_covariance(), np.diag(noise.measurement**2)
    reference.P, reference.x = observer.covariance, np.zeros(dense.states)
    reference.x[:2] = measured[0, :2]
    reference.sigmas_f = points.sigma_points(reference.x, reference.P)
    for k in range(len(measured)):
        acting[0] = commands[max(k - 2, 0)] if k else np.zeros(2)
        if k:
            reference.predict()
            # after Q has been added, sigma points are drawn anew, as (5.21) wants them and filterpy leaves to the caller
            reference.sigmas_f = points.sigma_points(reference.x, reference.P)
        reference.update(measured[k])
        observer.step_measured(measured[k], commands[max(k - 1, 0)])
        deviation = np.sqrt(np.diag(reference.P))
        assert np.abs((observer.state - reference.x) / deviation).max() < 1e-6, f"row {k}"
    assert np.allclose(observer.covariance, reference.P, rtol=1e-5, atol=1e-6 * np.outer(deviation, deviation).max())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_nis_is_in_its_band_when_noise_is_as_modelled(kind: str) -> None:
    model, noise = small_model(), small_noise()
    dense = DenseModel(model, noise)
    measured, commands, _ = drawn_rows(dense, noise, 2500, seed=5)
    observer = ModalObserver(model, noise, kind)  # type: ignore[arg-type]
    _, nis = observer.likelihood(measured, commands)
    assert 0.93 <= share_in_band(nis[100:, 0], nis[100:, 1]) <= 0.97


def test_the_linear_filter_knows_what_the_axes_motion_makes_the_sensors_feel() -> None:
    """At 1 rad/s the sensor's turning pulls by 0.5 m/s^2, a hundred times its noise, and a tilt of 1 mrad turns rates by twice theirs."""
    model, noise = small_model(), small_noise()
    dense = DenseModel(model, noise)
    measured, commands, states = drawn_rows(dense, noise, 400, seed=8, commands=np.tile([3.0, -2.0], (400, 1)))
    assert np.abs(states[-1, 2:4]).min() > 0.5
    errors = {}
    for kind in ("kf", "ekf"):
        observer = ModalObserver(model, noise, kind)  # type: ignore[arg-type]
        _, nis = observer.likelihood(measured, commands)
        assert 0.9 < nis[100:, 0].mean() / 10.0 < 1.1, kind
        found = []
        for k in range(400):
            observer.step_measured(measured[k], commands[max(k - 1, 0)])
            found.append(observer.state.copy())
        errors[kind] = np.sqrt(np.mean((np.array(found)[100:, 4:8] - states[100:, 4:8]) ** 2))
    assert errors["kf"] == pytest.approx(errors["ekf"], rel=0.02)


def test_the_covariance_says_how_wrong_the_state_is() -> None:
    model, noise = small_model(), small_noise()
    dense = DenseModel(model, noise)
    squares = []
    for seed in range(6):
        measured, commands, states = drawn_rows(dense, noise, 300, seed=20 + seed)
        observer = ModalObserver(model, noise, "ukf")
        for k in range(300):
            observer.step_measured(measured[k], commands[max(k - 1, 0)])
            if k >= 150 and k % 30 == 0:
                error = states[k] - observer.state
                squares.append(float(error @ np.linalg.solve(observer.covariance, error)))
    assert 0.8 < np.mean(squares) / dense.states < 1.2
