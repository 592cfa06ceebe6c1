"""Covariances of the plant where the loop couples the inputs strongly: conjugates and transposes count here."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_loop import orthogonal_multisine

from hil.identification import LocalModel, fast_local, periodic_records
from hil.identification.covariance import plant_covariance

COUPLING = np.array([[1.0, 0.9], [-0.2, 0.7]])
GAINS = np.array([[1.0, -0.5], [0.3, 2.0], [0.0, 1.0]])


def complex_normal(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)


def normalised_difference(estimated: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Estimated less sample covariance of errors (draws, size), in units of the standard deviations."""
    sample = errors.T @ np.conj(errors) / len(errors)
    deviation = np.sqrt(np.real(np.diagonal(estimated)))
    return (estimated - sample) / np.outer(deviation, deviation)


def test_noise_on_averaged_outputs_and_inputs_maps_to_the_plant() -> None:
    """(3.18) against Monte Carlo with a complex, coupled input matrix and noise shared by outputs and inputs."""
    rng = np.random.default_rng(70)
    U, G = complex_normal(rng, 2, 2), complex_normal(rng, 3, 2)
    root = 1e-4 * complex_normal(rng, 5, 5)
    noise = np.einsum("ij,dje->die", root, complex_normal(rng, 20000, 5, 2))
    estimates = (G @ U + noise[:, :3]) @ np.linalg.inv(U + noise[:, 3:])
    errors = (estimates - G).transpose(0, 2, 1).reshape(-1, 6)
    expected = plant_covariance(G[None], U[None], (root @ np.conj(root.T))[None])[0]
    assert np.abs(normalised_difference(expected, errors)).max() < 0.05


@pytest.mark.nightly
def test_a_fast_estimate_reports_its_full_covariance_under_coupling() -> None:
    """(3.45), (3.46) with static gains, so that nothing but the mapping can be wrong."""
    rng = np.random.default_rng(71)
    lines, period, periods = np.arange(1, 100), 256, 6
    errors, reported = [], []
    for _ in range(40):
        w = np.tile(orthogonal_multisine(rng, period, lines)[:1], (1, periods, 1))
        u = w @ COUPLING.T + 0.05 * rng.standard_normal(w.shape)
        y = w @ (GAINS @ COUPLING).T + 0.05 * rng.standard_normal((*w.shape[:2], 3))
        records = periodic_records(y[None], u[None], w[None], period_samples=period, sample_rate_Hz=64.0)
        response = fast_local(records, LocalModel(numerator=1, denominator=0, plant_window=8))
        errors.append((response.G - GAINS).transpose(0, 2, 1).reshape(len(lines), 6))
        reported.append(response.covariance("noise").mean(axis=0))
    assert np.abs(normalised_difference(np.mean(reported, axis=0), np.concatenate(errors))).max() < 0.1
