"""Claims of the local polynomial and rational methods, one pose or many, on plants inside their local model class unless said otherwise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, Loop, experiment, plant_response, simulate, two_mode_loop

from hil.identification import (
    ArbitraryRecords,
    IdentificationError,
    LocalModel,
    PeriodicRecords,
    PoseModel,
    arbitrary_local,
    fast_local,
    nd_local,
    periodic_records,
    robust_bla,
    robust_local,
)
from hil.identification.local.least_squares import local_fits

PERIOD = 1024
LINES = np.arange(1, 200)
NOISE = (0.3, 0.03, 0.03)
SMOOTH = {"damping": (0.5, 0.5), "lag": 0.5}  # smooth over a window of seventeen lines of 1/16 Hz: bias below 0.1 of the noise's deviation
LPM = LocalModel(denominator=0, numerator=4, plant_window=8)
LRM = LocalModel(numerator=3)


def records_of(
    rng: np.random.Generator,
    loop: Loop | None = None,
    *,
    realisations: int = 1,
    experiments: int = 1,
    periods: int = 8,
    noise: tuple[float, float, float] = NOISE,
    pose: tuple[object, ...] = (),
) -> PeriodicRecords:
    loop = loop or two_mode_loop(**SMOOTH)
    data = experiment(
        loop, rng, realisations=realisations, experiments=experiments, periods=periods, period=PERIOD, lines=LINES, noise=noise
    )
    return periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, pose=pose)


def truth_of(loop: Loop | None = None) -> np.ndarray:
    return plant_response(loop or two_mode_loop(**SMOOTH), LINES * SAMPLE_RATE_HZ / PERIOD)


def test_the_engine_solves_the_least_squares_problems_numpy_solves() -> None:
    rng = np.random.default_rng(0)
    w, z = (rng.standard_normal((90, n)) + 1j * rng.standard_normal((90, n)) for n in (2, 3))
    rows = np.stack([rng.permutation(90)[:25] for _ in range(11)])  # not a multiple of the lanes
    numerator, denominator, extra = rng.standard_normal((11, 25, 2)), rng.standard_normal((1, 25, 1)), rng.standard_normal((11, 25, 2))
    fits = local_fits(rows, numerator, denominator, w, z, extra)
    for b in range(11):
        W, Z = w[rows[b]], z[rows[b]]
        K = np.hstack((numerator[b][:, :1] * W, numerator[b][:, 1:] * W, -denominator[0] * Z, extra[b], W))
        solution, _, rank, _ = np.linalg.lstsq(K, Z, rcond=None)
        residual = Z - K @ solution
        np.testing.assert_allclose(fits.response[b], solution[-2:].T, rtol=1e-10)
        np.testing.assert_allclose(fits.inverse_gram[b], np.linalg.inv(K.conj().T @ K)[-2:, -2:], rtol=1e-9)
        np.testing.assert_allclose(fits.residual_products[b], residual.T @ residual.conj(), rtol=1e-10)
        assert fits.dof[b] == 25 - rank


def test_dependent_columns_count_as_freedom() -> None:
    rng = np.random.default_rng(0)
    z = rng.standard_normal((20, 1)) + 0j
    fits = local_fits(np.arange(20)[None], np.ones((1, 20, 2)), np.ones((1, 20, 0)), np.ones((20, 1), complex), z)
    assert fits.dof[0] == 19


def test_the_transient_is_removed_where_averaging_would_need_it_to_settle() -> None:
    """From a start out of equilibrium, without noise: a rational transient is found exactly, an unsettled average is off."""
    loop = two_mode_loop()
    records = records_of(np.random.default_rng(1), loop, experiments=2, periods=3, noise=(0.0, 0.0, 0.0))
    truth = truth_of(loop)
    local = np.abs(robust_local(records, LRM).G - truth).max()
    average = np.abs(robust_bla(records).G - truth).max()
    assert local < 1e-3 * average


def test_lpm_is_lrm_without_denominator_and_needs_a_smoother_transient() -> None:
    records = records_of(np.random.default_rng(1), experiments=2, noise=(0.0, 0.0, 0.0))
    rational = np.abs(robust_local(records, LRM).G - truth_of()).max()
    polynomial = np.abs(robust_local(records, replace(LRM, denominator=0)).G - truth_of()).max()
    assert rational < 1e-6
    assert rational < polynomial < 1e-3


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("estimate", "realisations", "experiments", "draws"),
    [
        pytest.param(lambda r: robust_local(r, replace(LRM, denominator=0)), 3, 2, 14, id="robust-lpm"),
        pytest.param(lambda r: robust_local(r, LRM), 3, 2, 14, id="robust-lrm"),
        pytest.param(lambda r: fast_local(r, LPM), 1, 1, 40, id="fast-lpm"),
        pytest.param(lambda r: fast_local(r, LRM), 1, 1, 40, id="fast-lrm"),
        pytest.param(lambda r: fast_local(r, LRM), 1, 2, 30, id="fast-lrm-two-experiments"),
    ],
)
def test_covariances_are_true_and_bounds_hold(estimate: Callable[..., object], realisations: int, experiments: int, draws: int) -> None:
    """Estimated against sample variance within 10 %, circles and ellipsoids at 95 +- 2 %, for noise and total; started in a transient."""
    rng = np.random.default_rng(30)
    truth = truth_of()
    made = [estimate(records_of(rng, realisations=realisations, experiments=experiments)) for _ in range(draws)]
    errors = np.stack([response.G - truth for response in made])
    for kind in ("noise", "total"):
        estimated = np.stack([response.standard_deviation(kind) for response in made])
        bounds = np.stack([response.bound(0.95, kind) for response in made])
        variance = np.mean(estimated**2, axis=0)
        assert np.mean(np.abs(errors) ** 2 / variance) == pytest.approx(1.0, abs=0.1)
        assert np.mean(np.abs(errors) <= bounds) == pytest.approx(0.95, abs=0.02)
        distance = np.stack(
            [response.column_distance(truth, kind) <= response.column_distance_bound(0.95, kind)[:, None] for response in made]
        )
        assert np.mean(distance) == pytest.approx(0.95, abs=0.02)


def test_a_denominator_of_second_order_takes_no_noise_for_dynamics() -> None:
    """r^2 z explains the noise of z: without a second look at the residuals variances come out at half."""
    rng, truth, model = np.random.default_rng(31), truth_of(), replace(LRM, denominator=2)
    made = [fast_local(records_of(rng), model) for _ in range(20)]
    for kind in ("noise", "total"):
        variance = np.mean([response.standard_deviation(kind) ** 2 for response in made], axis=0)
        assert np.mean([np.abs(response.G - truth) ** 2 / variance for response in made]) == pytest.approx(1.0, abs=0.1)


def test_a_controller_that_changes_over_the_window_leaves_the_noise_its_size() -> None:
    """U = w - C y with C(f): r u + C r y would be r^2 y, which explains the noise of y. Against what averaging says of the same data."""
    rng, settle, periods = np.random.default_rng(32), 4, 10
    loop = two_mode_loop(damping=(0.5, 0.5), lag=0.8)
    data = experiment(loop, rng, realisations=2, periods=periods, settle_periods=settle, period=PERIOD, lines=LINES, noise=NOISE)
    records = periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, settle_periods=settle)
    local, average = (np.mean(f(records).standard_deviation("noise") ** 2, axis=0) for f in (lambda r: robust_local(r, LRM), robust_bla))
    ratio = local * (periods + settle) / (average * periods)
    assert np.all((ratio > 0.95) & (ratio < 1.25))  # the transient taken off has a variance of its own, a tenth here


def test_one_pose_of_the_nd_method_is_the_method_for_one_pose() -> None:
    records = records_of(np.random.default_rng(2), pose=(0.0, 0.5))
    single, many = fast_local(records, LRM), nd_local([records], LRM)[0]
    np.testing.assert_array_equal(single.G, many.G)
    np.testing.assert_array_equal(single.total_covariance, many.total_covariance)


def poses_of(
    rng: np.random.Generator, noise: tuple[float, float, float] = NOISE, count: int = 7
) -> tuple[list[PeriodicRecords], np.ndarray]:
    poses = np.linspace(-1.0, 1.0, count)
    loops = [two_mode_loop(frequencies_Hz=(3.0 + 0.05 * pose, 7.0), **SMOOTH) for pose in poses]
    records = [records_of(rng, loop, pose=(0.0, pose), noise=noise) for loop, pose in zip(loops, poses, strict=True)]
    return records, np.stack([truth_of(loop) for loop in loops])


@pytest.mark.nightly
@pytest.mark.parametrize("model", [LPM, LRM], ids=["2d-lpm", "2d-lrm"])
def test_neighbouring_poses_lower_the_variance_and_covariances_stay_true(model: LocalModel) -> None:
    rng = np.random.default_rng(3)
    model = replace(model, plant_window=model.plant_window or 7)
    ratios, inside, gains = [], [], []
    for _ in range(5):
        records, truth = poses_of(rng)
        made = nd_local(records, model, PoseModel((1,), (1,), (2,)))
        for response, G in zip(made, truth, strict=True):
            ratios.append(np.abs(response.G - G) ** 2 / response.standard_deviation("noise") ** 2)
            inside.append(np.abs(response.G - G) <= response.bound(0.95, "total"))
        alone = fast_local(records[3], model)
        gains.append(np.mean(alone.standard_deviation("noise") ** 2 / made[3].standard_deviation("noise") ** 2))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
    assert np.median(ratios) == pytest.approx(np.log(2.0), rel=0.1)  # the median of a unit exponential
    assert np.mean(gains) > 3.0


def test_poses_excited_alike_still_tell_the_inputs_apart() -> None:
    """One excitation for all poses, as the thesis has it; windows by default."""
    rng = np.random.default_rng(33)
    made = []
    for pose in np.linspace(-1.0, 1.0, 5):
        same = records_of(np.random.default_rng(34), periods=4, noise=(0.0, 0.0, 0.0), pose=(0.0, pose))
        same.outputs[:] += 1e-3 * rng.standard_normal(same.outputs.shape)
        made.append(same)
    response = nd_local(made, LRM, PoseModel((1,), (1,), (2,)))[2]
    assert np.mean(np.abs(response.G - truth_of()) <= response.bound(0.95, "total")) > 0.9


def test_an_edge_pose_falls_back_on_its_own_data() -> None:
    records, _ = poses_of(np.random.default_rng(4))
    made = nd_local(records, LRM, PoseModel((1,), (1,), (2,)))
    np.testing.assert_allclose(made[0].G, fast_local(records[0], LRM).G, rtol=1e-12)


@pytest.mark.slow
def test_scattered_poses_over_two_parameters_are_taken_as_they_come() -> None:
    rng = np.random.default_rng(5)
    poses = rng.uniform(-1.0, 1.0, (14, 2))
    loops = [two_mode_loop(frequencies_Hz=(3.0 + 0.03 * a, 7.0 - 0.03 * b), **SMOOTH) for a, b in poses]
    records = [records_of(rng, loop, pose=tuple(pose)) for loop, pose in zip(loops, poses, strict=True)]
    made = nd_local(records, replace(LRM, plant_window=7), PoseModel((1, 1), (1, 1), (1, 1)))
    inside = [np.abs(r.G - truth_of(loop)) <= r.bound(0.95, "total") for r, loop in zip(made, loops, strict=True)]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_a_cubic_spring_shows_as_total_above_noise_variance() -> None:
    rng = np.random.default_rng(6)
    quiet = (1e-3, 1e-4, 1e-4)
    linear = fast_local(records_of(rng, noise=quiet), LRM)
    cubic = fast_local(records_of(rng, two_mode_loop(cubic=2e-4, **SMOOTH), noise=quiet), LRM)
    assert np.median(linear.standard_deviation("nonlinear") / linear.standard_deviation("noise")) < 1.0
    assert np.median(cubic.standard_deviation("nonlinear") / cubic.standard_deviation("noise")) > 10.0


def test_any_excitation_serves_an_arbitrary_method() -> None:
    rng = np.random.default_rng(7)
    loop, T = two_mode_loop(**SMOOTH), 4096
    ratios, inside = [], []
    for _ in range(12):
        w = rng.standard_normal((1, T, 2))
        y, u = simulate(loop, w[0], rng.standard_normal((T, 3)) * NOISE, initial=rng.standard_normal(6))
        records = ArbitraryRecords(y[None], u[None], w, SAMPLE_RATE_HZ, ("a", "b", "c"), ("u", "v"), ("",) * 3, ("",) * 2)
        response = arbitrary_local([records], (0.5, 20.0), LRM)[0]
        error = np.abs(response.G - plant_response(loop, response.frequencies_Hz))
        ratios.append(error**2 / response.standard_deviation() ** 2)
        inside.append(error <= response.bound())
    dof = response.total_dof[0]
    assert np.mean(ratios) == pytest.approx(dof / (dof - 1), rel=0.1)  # the mean of F(2, 2 dof)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("spoilt", "message"),
    [("outputs", "outputs have missing samples"), ("excitation", "input v is not excited in any record")],
)
def test_records_that_an_arbitrary_method_cannot_take_get_one_clear_line(spoilt: str, message: str) -> None:
    arrays = {"outputs": np.ones((1, 64, 3)), "inputs": np.ones((1, 64, 2)), "excitation": np.ones((1, 64, 2))}
    arrays[spoilt][0, :, 1] = np.nan if spoilt == "outputs" else 0.0
    with pytest.raises(IdentificationError, match=message):
        ArbitraryRecords(*arrays.values(), 1.0, ("a", "b", "c"), ("u", "v"), ("",) * 3, ("",) * 2)


@pytest.mark.parametrize("initial", [0.0, 1.0])
def test_open_loop_needs_no_measured_input(initial: float) -> None:
    rng = np.random.default_rng(8)
    loop = two_mode_loop(feedback=0.0, **SMOOTH)
    data = experiment(loop, rng, realisations=1, experiments=1, periods=4, period=PERIOD, lines=LINES)
    data["outputs"][0, 0] += initial * simulate(loop, np.zeros((4 * PERIOD, 2)), np.zeros((4 * PERIOD, 3)), np.ones(6))[0]
    records = periodic_records(data["outputs"], None, data["excitation"], period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ)
    response = fast_local(records, LRM)
    truth = truth_of(loop)
    assert np.abs(response.G - truth).max() < 1e-3 * np.abs(truth).max()


def test_windows_without_freedom_name_the_one_that_would_do() -> None:
    records = records_of(np.random.default_rng(9), periods=3)
    with pytest.raises(IdentificationError, match=r"transient_window = 3: 6 bins for 6 unknowns .* transient_window = 4 or more would do"):
        fast_local(records, replace(LRM, transient_window=3))
    fast_local(records, replace(LRM, transient_window=4))
    with pytest.raises(IdentificationError, match=r"plant_window = 5: 11 equations for 11 unknowns .* plant_window = 6 or more would do"):
        fast_local(records, replace(LRM, plant_window=5))
    fast_local(records, replace(LRM, plant_window=6))


def test_one_period_is_told_what_to_do() -> None:
    with pytest.raises(IdentificationError, match="one period has no bins"):
        fast_local(records_of(np.random.default_rng(9), periods=1))


def test_orders_too_high_for_the_lines_are_told() -> None:
    with pytest.raises(IdentificationError, match="wider than the 199 lines"):
        fast_local(records_of(np.random.default_rng(9)), LocalModel(numerator=110, denominator=0))


def test_missing_samples_leave_the_longest_run_of_periods() -> None:
    records = records_of(np.random.default_rng(10))
    records.outputs[0, 0, 2 * PERIOD + 5] = np.nan
    response = fast_local(records, LRM)
    assert response.settings["periods"] == 5
    assert "5 complete periods in a row" in " ".join(response.notes)
    assert np.mean(np.abs(response.G - truth_of()) <= response.bound(0.95, "total")) == pytest.approx(0.95, abs=0.04)


def test_periodic_borders_help_where_lines_reach_half_the_sample_rate() -> None:
    rng = np.random.default_rng(11)
    loop = two_mode_loop(**SMOOTH)
    lines = np.arange(1, PERIOD // 2)
    data = experiment(loop, rng, realisations=1, experiments=1, periods=8, period=PERIOD, lines=lines, noise=(0.03, 0.003, 0.003))
    records = periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ)
    asymmetric = fast_local(records, LocalModel(numerator=3))
    periodic = fast_local(records, LocalModel(numerator=3, border="periodic"))
    edge = slice(-3, None)
    assert np.mean(periodic.standard_deviation("noise")[edge]) < 0.7 * np.mean(asymmetric.standard_deviation("noise")[edge])
    truth = plant_response(loop, records.frequencies_Hz)
    assert np.mean(np.abs(periodic.G - truth)[edge] <= periodic.bound(0.95, "total")[edge]) > 0.8
