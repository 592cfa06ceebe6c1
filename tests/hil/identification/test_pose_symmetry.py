"""Claims of symmetry over the poses: windows at the border go on with images, bounds stay true. Monte Carlo on loops that have it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from simulated_loop import SAMPLE_RATE_HZ, Loop, experiment, plant_response, two_mode_loop

from hil.identification import (
    IdentificationError,
    LocalModel,
    PeriodicRecords,
    PoseModel,
    PoseSymmetry,
    fast_local,
    nd_local,
    periodic_records,
)

PERIOD, LINES, NOISE = 1024, np.arange(1, 80), (0.3, 0.03, 0.03)
MODEL = LocalModel(numerator=3, plant_window=8)
DRAWS = 10

MIRRORED = (np.linspace(-1.0, 1.0, 5), lambda pose: 3.0 + 0.04 * (pose - 1.0) ** 2, PoseSymmetry(mirrors=(1.0,)), 4)
TURNING = (np.arange(8) * np.pi / 4, lambda pose: 3.0 + 0.005 * np.cos(pose), PoseSymmetry(period=2 * np.pi), 0)
FOLDED = (np.linspace(-1.0, 1.0, 5), lambda pose: 3.0 + 0.05 * pose**2, PoseSymmetry(mirrors=(0.0,)), 0)


def loop_at(pose: float, frequency_Hz: Callable[..., object]) -> Loop:
    return two_mode_loop(frequencies_Hz=(frequency_Hz(pose), 7.0), damping=(0.5, 0.5), lag=0.5)


def draw(rng: np.random.Generator, poses: np.ndarray, frequency_Hz: Callable[..., object]) -> list[PeriodicRecords]:
    made = []
    for pose in poses:
        data = experiment(
            loop_at(pose, frequency_Hz), rng, realisations=1, experiments=1, periods=6, period=PERIOD, lines=LINES, noise=NOISE
        )
        made.append(periodic_records(**data, period_samples=PERIOD, sample_rate_Hz=SAMPLE_RATE_HZ, pose=(0.0, pose)))
    return made


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("case", "gain"),
    [
        pytest.param(MIRRORED, 2.0, id="mirror-at-the-edge"),  # three poses, constant and square
        pytest.param((*MIRRORED[:3], 3), 1.5, id="beside-the-mirror"),  # its own image lies in its window
        pytest.param(TURNING, 2.5, id="full-turn"),  # five poses, a parabola: 35 / 17
        pytest.param(FOLDED, 1.7, id="mirror-within"),  # the other end's pose
    ],
)
def test_at_the_border_images_lower_the_variance_and_bounds_stay_true(
    case: tuple[np.ndarray, Callable[..., object], PoseSymmetry, int], gain: float
) -> None:
    poses, frequency_Hz, symmetry, edge = case
    rng = np.random.default_rng(80)
    truth = plant_response(loop_at(poses[edge], frequency_Hz), LINES * SAMPLE_RATE_HZ / PERIOD)
    inside, variances, squares, gains = {"noise": [], "total": []}, {"noise": [], "total": []}, [], []
    for _ in range(DRAWS):
        records = draw(rng, poses, frequency_Hz)
        response = nd_local(records, MODEL, PoseModel((2,), (2,), (2,), symmetry=(symmetry,)))[edge]
        error = np.abs(response.G - truth)
        squares.append(error**2)
        for kind in ("noise", "total"):
            inside[kind].append(error <= response.bound(0.95, kind))
            variances[kind].append(response.standard_deviation(kind) ** 2)
        alone = fast_local(records[edge], MODEL)
        gains.append(alone.standard_deviation("noise") ** 2 / response.standard_deviation("noise") ** 2)
    for kind in ("noise", "total"):
        assert np.mean(inside[kind]) == pytest.approx(0.95, abs=0.025)
        assert np.mean(np.mean(squares, axis=0) / np.mean(variances[kind], axis=0)) == pytest.approx(1.0, abs=0.15)
    assert np.mean(gains) > gain


def test_the_estimate_has_the_symmetry_it_was_given() -> None:
    """At a mirrored pair of poses one response, from both poses' data."""
    poses, frequency_Hz, symmetry, _ = FOLDED
    made = nd_local(draw(np.random.default_rng(81), poses, frequency_Hz), MODEL, PoseModel((2,), (2,), (2,), symmetry=(symmetry,)))
    np.testing.assert_allclose(made[1].G, made[3].G, rtol=1e-9)


def test_without_a_symmetry_nothing_changes_and_one_per_parameter_is_asked_for() -> None:
    poses, frequency_Hz, symmetry, _ = MIRRORED
    records = draw(np.random.default_rng(82), poses, frequency_Hz)
    plain, declared = (nd_local(records, MODEL, PoseModel((1,), (1,), (2,), symmetry=s)) for s in ((), (PoseSymmetry(),)))
    np.testing.assert_array_equal(plain[1].G, declared[1].G)
    with pytest.raises(IdentificationError, match="2 symmetries for 1 scheduling parameters"):
        nd_local(records, MODEL, PoseModel((1,), (1,), (2,), symmetry=(symmetry, symmetry)))
