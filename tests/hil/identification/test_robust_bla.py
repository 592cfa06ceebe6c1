"""Claims of the robust best linear approximation, held against a simulation whose frequency response is known from its matrices."""

from __future__ import annotations

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, Loop, experiment, orthogonal_multisine, plant_response, simulate, two_mode_loop

from hil.identification import FrequencyResponse, IdentificationError, PeriodicRecords, periodic_records, robust_bla

PERIOD = 256
ODD_LINES = np.arange(1, 100, 2)
NOISE = (0.1, 0.01, 0.01)
QUIET = (1e-4, 1e-5, 1e-5)
SETTLE = 6  # 1536 samples: the slowest closed-loop pole, 0.9925, is down to 1e-5


def records_of(data: dict[str, np.ndarray], settle: int = SETTLE, **more: object) -> PeriodicRecords:
    return periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, settle_periods=settle, **more)


def run(
    rng: np.random.Generator,
    loop: Loop | None = None,
    noise: tuple[float, float, float] = NOISE,
    realisations: int = 4,
    periods: int = 6,
    lines: np.ndarray = ODD_LINES,
    **more: object,
) -> FrequencyResponse:
    data = experiment(
        loop or two_mode_loop(), rng, realisations=realisations, periods=periods, settle_periods=SETTLE, lines=lines, noise=noise, **more
    )
    return robust_bla(records_of(data))


@pytest.fixture(scope="module")
def draws() -> list[FrequencyResponse]:
    """Sixty estimates of the same linear loop with fresh noise and fresh phases."""
    rng = np.random.default_rng(20)
    return [run(rng) for _ in range(60)]


def test_without_noise_the_estimate_is_the_plants_response() -> None:
    response = run(np.random.default_rng(1), noise=(0.0, 0.0, 0.0), realisations=1, periods=1, loop=two_mode_loop(damping=(0.2, 0.2)))
    truth = plant_response(two_mode_loop(damping=(0.2, 0.2)), response.frequencies_Hz)
    np.testing.assert_allclose(response.G, truth, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["noise", "total"])
def test_the_truth_lies_within_the_95_percent_bounds_at_95_percent_of_the_lines(draws: list[FrequencyResponse], kind: str) -> None:
    truth = plant_response(two_mode_loop(), draws[0].frequencies_Hz)
    inside = np.mean([np.abs(draw.G - truth) <= draw.bound(0.95, kind) for draw in draws])
    assert inside == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("kind", ["noise", "total"])
def test_columns_lie_within_hotellings_ellipsoid(draws: list[FrequencyResponse], kind: str) -> None:
    truth = plant_response(two_mode_loop(), draws[0].frequencies_Hz)
    inside = np.mean([draw.column_distance(truth, kind) <= draw.column_distance_bound(0.95, kind)[:, None] for draw in draws])
    assert inside == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("kind", ["noise", "total"])
def test_estimated_covariance_is_the_sample_covariance(draws: list[FrequencyResponse], kind: str) -> None:
    truth = plant_response(two_mode_loop(), draws[0].frequencies_Hz)
    errors = np.stack([(draw.G - truth).transpose(0, 2, 1).reshape(len(truth), 6) for draw in draws])  # vec stacks columns
    sample = np.einsum("dli,dlj->lij", errors, np.conj(errors)) / len(draws)
    estimated = np.mean([draw.covariance(kind) for draw in draws], axis=0)
    scale = np.sqrt(np.real(np.einsum("lii->li", estimated)))
    normalised = (estimated - sample) / (scale[:, :, None] * scale[:, None, :])
    np.testing.assert_allclose(normalised.mean(axis=0), 0.0, atol=0.08)


def test_a_linear_plant_shows_no_nonlinear_distortion_beyond_chance(draws: list[FrequencyResponse]) -> None:
    """Noise and total variance estimate the same thing; their ratio over lines averages to one."""
    ratio = np.mean([np.mean(np.einsum("lii->li", d.covariance("total") / d.covariance("noise").real).real) for d in draws])
    assert ratio == pytest.approx(1.0, abs=0.05)


def test_a_cubic_spring_shows_odd_lines_and_nonlinear_variance() -> None:
    rng = np.random.default_rng(3)
    lines = np.setdiff1d(ODD_LINES, ODD_LINES[2::4])  # one in four odd lines detects
    response = run(rng, two_mode_loop(cubic=2e-4), lines=lines, noise=QUIET)
    found = response.even_odd
    odd = found.level[~found.even, 2].mean()
    assert odd > 100 * found.level[found.even, 2].mean()
    assert odd > 100 * found.noise[:, 2].mean()
    deviation = response.standard_deviation("nonlinear")[:10, 1:].mean()
    assert deviation > 10 * response.standard_deviation("noise")[:10, 1:].mean()


def test_a_quadratic_spring_shows_even_lines_only() -> None:
    rng = np.random.default_rng(4)
    lines = np.setdiff1d(ODD_LINES, ODD_LINES[2::4])
    found = run(rng, two_mode_loop(square=1e-4), lines=lines, noise=QUIET).even_odd
    assert found.level[found.even, 2].mean() > 100 * found.level[~found.even, 2].mean()


def test_nonlinear_variance_is_that_of_one_realisation() -> None:
    """Estimates from one realisation each scatter by the variance the many-realisation estimate reports."""
    rng = np.random.default_rng(5)
    loop = two_mode_loop(cubic=2e-4)
    many = run(rng, loop, realisations=24, periods=2, noise=(0.0, 0.0, 0.0))
    singles = [run(rng, loop, realisations=1, periods=1, noise=(0.0, 0.0, 0.0)).G for _ in range(24)]
    scatter = np.var(np.stack(singles), axis=0, ddof=1)
    reported = many.standard_deviation("nonlinear") ** 2
    assert np.median(reported / scatter) == pytest.approx(1.0, abs=0.2)


def test_one_period_leaves_the_total_covariance() -> None:
    response = run(np.random.default_rng(6), periods=1)
    assert response.noise_covariance is None
    assert response.total_covariance is not None
    assert "one period" in " ".join(response.notes)


def test_one_realisation_leaves_the_noise_covariance() -> None:
    response = run(np.random.default_rng(6), realisations=1)
    assert response.total_covariance is None
    with pytest.raises(IdentificationError, match="total covariance: it takes two realisations"):
        response.standard_deviation("total")


def test_single_input_experiments_do_as_well_as_orthogonal_ones() -> None:
    rng = np.random.default_rng(7)
    excitations = np.stack([orthogonal_multisine(rng, PERIOD, ODD_LINES) for _ in range(3)])
    excitations[:, 0, :, 1] = 0.0
    excitations[:, 1, :, 0] = 0.0
    response = run(rng, excitations=excitations)
    truth = plant_response(two_mode_loop(), response.frequencies_Hz)
    assert np.mean(np.abs(response.G - truth) <= response.bound(0.95, "noise")) == pytest.approx(0.95, abs=0.04)


def test_an_input_without_excitation_is_named() -> None:
    data = experiment(two_mode_loop(), np.random.default_rng(8), realisations=1, periods=2, lines=ODD_LINES)
    data["excitation"][..., 1] = 0.0
    with pytest.raises(IdentificationError, match="input u2 is not excited"):
        records_of(data, settle=0)


def test_an_excitation_of_another_period_is_refused() -> None:
    data = experiment(two_mode_loop(), np.random.default_rng(8), realisations=1, periods=4, lines=ODD_LINES)
    with pytest.raises(IdentificationError, match="does not repeat every 200 samples"):
        periodic_records(**data, period_samples=200, sample_rate_Hz=SAMPLE_RATE_HZ)


def test_experiments_with_the_same_excitation_are_refused() -> None:
    data = experiment(two_mode_loop(), np.random.default_rng(8), realisations=2, periods=2, lines=ODD_LINES)
    data["excitation"][:, 1] = data["excitation"][:, 0]
    with pytest.raises(IdentificationError, match="not orthogonal"):
        robust_bla(records_of(data, settle=0))


def test_one_experiment_for_two_inputs_is_refused() -> None:
    data = experiment(two_mode_loop(), np.random.default_rng(8), realisations=2, periods=2, lines=ODD_LINES, experiments=1)
    with pytest.raises(IdentificationError, match="1 experiments for 2 inputs"):
        robust_bla(records_of(data, settle=0))


def test_periods_with_missing_samples_are_left_out_and_bounds_still_hold() -> None:
    rng = np.random.default_rng(9)
    inside = []
    for _ in range(10):
        data = experiment(two_mode_loop(), rng, realisations=3, periods=6, settle_periods=SETTLE, lines=ODD_LINES, noise=NOISE)
        data["outputs"][1, 0, (SETTLE + 2) * PERIOD + 17, 1] = np.nan
        data["inputs"][2, 1, (SETTLE + 1) * PERIOD : (SETTLE + 4) * PERIOD] = np.nan
        response = robust_bla(records_of(data))
        truth = plant_response(two_mode_loop(), response.frequencies_Hz)
        inside.append(np.abs(response.G - truth) <= response.bound(0.95, "noise"))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert "4 of 36 periods have missing samples" in " ".join(response.notes)


def test_an_excited_nyquist_line_is_left_out_and_said() -> None:
    rng = np.random.default_rng(10)
    data = experiment(two_mode_loop(), rng, realisations=2, periods=2, settle_periods=SETTLE, lines=ODD_LINES)
    alternating = np.cos(np.pi * np.arange(data["excitation"].shape[2]))[:, None]
    data["excitation"] += alternating
    response = robust_bla(records_of(data))
    assert response.lines.max() == ODD_LINES.max()
    assert "Nyquist" in " ".join(response.notes)


def test_a_saturated_input_biases_nothing_since_the_response_starts_at_the_command() -> None:
    """Clipping makes the excitation another one; the plant stays linear from the command on."""
    rng = np.random.default_rng(11)
    loop = two_mode_loop(feedback=0.0, damping=(0.2, 0.2))
    w = np.stack([orthogonal_multisine(rng, PERIOD, ODD_LINES) for _ in range(2)])
    u = np.tile(np.clip(w, -8.0, 8.0), (1, 1, 5, 1))
    y = np.stack([[simulate(loop, u[m, e], np.zeros((5 * PERIOD, 3)))[0] for e in range(2)] for m in range(2)])
    response = robust_bla(records_of({"outputs": y, "inputs": u, "excitation": np.tile(w, (1, 1, 5, 1))}, settle=4))
    truth = plant_response(loop, response.frequencies_Hz)
    np.testing.assert_allclose(response.G[:, 1:], truth[:, 1:], rtol=0.1, atol=0.02)
