"""Claims: what stands in tables is what the equations say, and sigma points that go through them are the textbook's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, FREQUENCIES_Hz, drawn_rows, small_model, small_noise, with_lower_mode

from controllers.observers.extended_kalman import next_and_read
from controllers.observers.modal_observer import ModalObserver


def asked(observer: ModalObserver, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State a sample after x while u acts, and what the sensors read in x, of the model as it was last prepared."""
    after, read = np.zeros(len(x)), np.zeros(10)
    next_and_read(observer.constants, observer.scheduled, x, u, after, read)
    read[4:] += x[-6:]
    return after, read


@pytest.mark.slow
@pytest.mark.parametrize("has_places", [False, True])
def test_a_sample_and_its_readings_are_those_of_the_equations_written_with_matrices(has_places: bool) -> None:
    model, noise = small_model(), small_noise()
    if has_places:
        over_stiffness = np.append([1.0, 1.0], (2.0 * np.pi * FREQUENCIES_Hz) ** -2)[:, None, None]
        model = replace(model, directions=over_stiffness * np.random.default_rng(4).normal(size=(6, 3, 1)))
        time, middle = np.array([0.1, 0.05, 0.2]), np.array([0.0, 4.0, 9.0])
        noise = replace(noise, disturbance=np.full(3, 0.5), disturbance_time_s=time, disturbance_Hz=middle)
        noise = replace(noise, low_pass=np.array([False, False, True]))
    observer, dense = ModalObserver(model, noise), DenseModel(model, noise)
    observer.linearised(np.zeros(2))  # prepares the model
    generator = np.random.default_rng(8)
    for _ in range(20):
        x, u = generator.normal(size=dense.states), generator.normal(size=2)
        after, read = asked(observer, x, u)
        expected = dense.transition(x, u), dense.outputs(x, u)
        assert np.abs(after - expected[0]).max() < 1e-12 * np.abs(expected[0]).max()
        assert np.abs(read - expected[1]).max() < 1e-12 * np.abs(expected[1]).max()


@pytest.mark.slow
def test_with_adapted_modes_the_ukf_is_one_that_asks_the_model_at_every_sigma_point() -> None:
    measured, commands, _ = drawn_rows(DenseModel(small_model(), small_noise()), small_noise(), 60, seed=11)
    observer = ModalObserver(with_lower_mode(small_model(), 1.1), small_noise(adapted_walk=1e-3), "ukf", adapted=(0, 2))
    steady = DenseModel(observer.model, small_noise())
    states, R = len(observer.state), np.diag(observer.noise.measurement**2)
    own = np.delete(np.arange(states), [18, 19])  # the ratios stand before the biases
    Q = np.diag([0.0] * 18 + [observer.noise.adapted_walk**2 / observer.model.sample_rate_Hz] * 2 + [0.0] * 6)
    Q[np.ix_(own, own)] += steady.process_covariance()
    for k in range(len(measured)):
        x, P, is_later = observer.state.copy(), observer.covariance, k > 0
        u = commands[max(k - 2, 0)]
        observer.step_measured(measured[k], commands[max(k - 1, 0)])
        if not is_later:
            continue
        points = x + _deviations(P)
        after = np.array([asked(observer, point, u)[0] for point in points])
        x, P = after.mean(axis=0), (after - after.mean(axis=0)).T @ (after - after.mean(axis=0)) / len(after) + Q
        points = x + _deviations(P)
        read = np.array([asked(observer, point, u)[1] for point in points])
        mean, away = read.mean(axis=0), points - x
        S, C = (read - mean).T @ (read - mean) / len(read) + R, away.T @ (read - mean) / len(read)
        gain = np.linalg.solve(S, C.T).T
        x, P = x + gain @ (measured[k] - mean), P - gain @ S @ gain.T
        deviation = np.sqrt(np.diag(P))
        assert np.abs((observer.state - x) / deviation).max() < 1e-9, f"row {k}"
        assert np.abs((observer.covariance - P) / np.outer(deviation, deviation)).max() < 1e-9, f"row {k}"


def _deviations(P: np.ndarray) -> np.ndarray:
    """Sigma points (2 n, n) about nothing, equal weights."""
    root = np.sqrt(len(P)) * np.linalg.cholesky(P).T
    return np.concatenate((root, -root))
