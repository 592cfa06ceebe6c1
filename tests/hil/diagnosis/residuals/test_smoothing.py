"""Motion from samples: right within its own deviations, at even and uneven times, and kinematically one."""

import numpy as np
import pytest

from hil.diagnosis.residuals.smoothing import smoothed

SEED = 4


def motion(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    slow, fast = 2.0 * np.pi * 0.3, 2.0 * np.pi * 4.0
    position = 0.5 * np.sin(slow * time) + 0.004 * np.sin(fast * time)
    speed = 0.5 * slow * np.cos(slow * time) + 0.004 * fast * np.cos(fast * time)
    return position, speed, -0.5 * slow**2 * np.sin(slow * time) - 0.004 * fast**2 * np.sin(fast * time)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("resolution", [1e-5, 1e-3])
def test_position_speed_and_acceleration_are_right_within_their_deviations(uneven: bool, resolution: float) -> None:
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    time = np.sort(rng.uniform(0.0, 20.0, 4000)) if uneven else np.arange(0.0, 20.0, 0.005)
    position, speed, acceleration = motion(time)
    found = smoothed(time, np.round(position / resolution) * resolution, resolution, time)
    inner = slice(100, -100)
    for estimate, deviation, truth in (
        (found.position, found.position_deviation, position),
        (found.speed, found.speed_deviation, speed),
        (found.acceleration, found.acceleration_deviation, acceleration),
    ):
        error = (estimate - truth)[inner] / deviation[inner]
        assert np.sqrt(np.mean(error**2)) < 1.3


def test_missing_samples_are_bridged() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    position, speed, _ = motion(time)
    samples = np.round(position / 1e-5) * 1e-5
    samples[500:504] = np.nan
    found = smoothed(time, samples, 1e-5, time)
    np.testing.assert_allclose(found.position[495:510], position[495:510], atol=1e-4)
    np.testing.assert_allclose(found.speed[495:510], speed[495:510], atol=0.02)


def test_the_slow_motion_is_the_integral_of_an_acceleration_that_is_linear_between_rows() -> None:
    time = np.arange(0.0, 5.0, 0.005)
    position, _, _ = motion(time)
    q, v, a = smoothed(time, np.round(position / 1e-5) * 1e-5, 1e-5, time).slow[:, :3].T
    h = 0.005
    jerk = np.diff(a) / h
    np.testing.assert_allclose(q[1:], q[:-1] + h * v[:-1] + h**2 / 2 * a[:-1] + h**3 / 6 * jerk, atol=1e-11)
    np.testing.assert_allclose(v[1:], v[:-1] + h * a[:-1] + h**2 / 2 * jerk, atol=1e-8)


def test_every_other_sample_may_be_missing() -> None:
    time = np.arange(0.0, 10.0, 0.005)
    position, speed, _ = motion(time)
    samples = np.where(np.arange(len(time)) % 2 == 0, np.round(position / 1e-5) * 1e-5, np.nan)
    found = smoothed(time, samples, 1e-5, time)
    inner = slice(100, -100)
    np.testing.assert_allclose(found.position[inner], position[inner], atol=1e-4)
    np.testing.assert_allclose(found.speed[inner], speed[inner], atol=0.02)
