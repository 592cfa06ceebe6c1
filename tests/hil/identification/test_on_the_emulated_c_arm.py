"""Claims about frequency responses of the emulated C-arm, held against the linearisation of its plant, which knows no estimator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_loop import orthogonal_multisine

from hil.identification import LocalModel, PeriodicRecords, periodic_records, resonances, robust_bla, robust_local
from hil.machine import load_machine
from hil.simulation import Inputs, Simulator
from hil.simulation.linear import sampled_response
from virtual_bus.physics import Physics

OUTPUTS = ("imu_x", "imu_y", "imu_z", "position_propeller", "position_roll")
POSE = np.radians([10.0, 30.0])
PERIOD, SETTLE, PERIODS, REALISATIONS = 2560, 3, 5, 3
LINES = np.arange(5, 401, 2)  # 0.5 to 40 Hz
EXCITATION_RMS_A = 0.5
NOISE = np.array((5e-3, 5e-3, 5e-3, 2e-5, 2e-5))
BIASED = 0.1  # of the noise's standard deviation


def records(simulator: Simulator, rng: np.random.Generator, noise: np.ndarray) -> PeriodicRecords:
    rows = (SETTLE + PERIODS) * PERIOD
    y, u, w = (np.empty((REALISATIONS, 2, rows, n)) for n in (len(OUTPUTS), 2, 2))
    for m in range(REALISATIONS):
        period = orthogonal_multisine(rng, PERIOD, LINES)
        w[m] = np.tile(period * EXCITATION_RMS_A / period.std(), (1, SETTLE + PERIODS, 1))
        for e in range(2):
            error = noise * rng.standard_normal((rows, len(OUTPUTS)))
            reference = np.tile(POSE, (rows, 1)) - error[:, 3:]  # noise on an encoder is fed back
            run = simulator.run(Inputs(reference, w[m, e], np.zeros((rows, 2)), None, POSE))
            y[m, e], u[m, e] = np.column_stack((run.imu[:, :3], run.position)) + error, run.command
    return periodic_records(y, u, w, period_samples=PERIOD, sample_rate_Hz=256.0, settle_periods=SETTLE, output_names=OUTPUTS)


@pytest.fixture(scope="module")
def measured() -> tuple[PeriodicRecords, PeriodicRecords, np.ndarray]:
    """Records with noise and without, and the plant's own response."""
    machine = load_machine("carm")
    simulator, rng = Simulator(machine), np.random.default_rng(70)
    noisy, clean = records(simulator, rng, NOISE), records(simulator, rng, 0.0 * NOISE)
    return noisy, clean, sampled_response(machine, POSE, LINES * 256.0 / PERIOD, OUTPUTS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "estimate",
    [
        pytest.param(robust_bla, id="robust-bla"),
        pytest.param(lambda r: robust_local(r, LocalModel(denominator=0)), id="robust-lpm"),
        pytest.param(lambda r: robust_local(r, LocalModel()), id="robust-lrm"),
    ],
)
def test_the_linearisation_lies_within_the_bounds_at_95_percent_of_unbiased_lines(
    measured: tuple[PeriodicRecords, PeriodicRecords, np.ndarray], estimate: Callable[..., object]
) -> None:
    """Bias, what is left without noise (the plant is not quite linear over the motion), beyond a tenth of the noise is counted apart."""
    noisy, clean, truth = measured
    response = estimate(noisy)
    bias = np.abs(estimate(clean).G - truth)
    unbiased = bias < BIASED * response.standard_deviation("noise")
    assert unbiased.mean() > 0.5
    for kind in ("noise", "total"):
        inside = np.abs(response.G - truth) <= response.bound(0.95, kind)
        assert inside[unbiased].mean() == pytest.approx(0.95, abs=0.02)
        assert inside[~unbiased].mean() > 0.85


def test_a_linear_plant_shows_no_distortion_beyond_chance(measured: tuple[PeriodicRecords, PeriodicRecords, np.ndarray]) -> None:
    """Sums over lines and elements: total over noise variance is one on average where only noise tells records apart."""
    response = robust_bla(measured[0])
    ratio = response.standard_deviation("total") ** 2 / response.standard_deviation("noise") ** 2
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_resonances_of_the_measured_response_are_the_plants_eigenvalues(
    measured: tuple[PeriodicRecords, PeriodicRecords, np.ndarray],
) -> None:
    """In no more than two of eight bounds of 95 % may the truth be missing; chance makes that in one of 20 times two of eight."""
    response = replace(robust_bla(measured[0]), output_names=OUTPUTS)
    found = resonances(response)
    poles = np.linalg.eigvals(Physics(load_machine("carm").plant, noise=False).linearise(POSE).A)
    poles = poles[(poles.imag > 0.0) & (np.abs(poles) > 2.0 * np.pi * 3.0) & (np.abs(poles) < 2.0 * np.pi * 38.0)]
    truth = sorted((abs(pole) / (2.0 * np.pi), -pole.real / abs(pole)) for pole in poles if -pole.real < 0.3 * abs(pole))
    assert len(found.found) == len(truth) == 4
    inside = []
    for one, (frequency_Hz, damping) in zip(found.found, truth, strict=True):
        assert one.frequency_Hz == pytest.approx(frequency_Hz, rel=1e-3)
        assert one.damping == pytest.approx(damping, rel=0.05)
        inside += [
            one.frequency_ci95_Hz[0] <= frequency_Hz <= one.frequency_ci95_Hz[1],
            one.damping_ci95[0] <= damping <= one.damping_ci95[1],
        ]
    assert sum(inside) >= 6, inside
