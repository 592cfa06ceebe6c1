"""Claims: gains are what a turned and wrongly scaled sensor reads, offsets of link sides what a link encoder reads wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_models import DenseModel, drawn_rows, small_model, small_noise
from scipy.spatial.transform import Rotation

from controllers.errors import DesignError
from controllers.observers.extended_kalman import next_and_read
from controllers.observers.modal_observer import FilterKind, ModalObserver

GAINED = replace(
    small_noise(), initial_gain=np.repeat([0.006, 0.003], [3, 4]), offset_walk=np.full(10, 1e-9), initial_offset=np.repeat([1e-6, 1e-4], 5)
)
GAINS = np.array([2e-3, -3e-3, 1e-3, 1e-3, 2e-3, -1e-3, 2e-3])


def wrongly(read: np.ndarray, gains: np.ndarray = GAINS) -> np.ndarray:
    """Readings (10,) of a sensor that is turned in its mount and scales wrongly."""
    turned = Rotation.from_rotvec(gains[:3]).as_matrix()
    return np.concatenate((read[:4], gains[3:6] * read[4:7] + turned @ read[4:7], gains[6] * read[7:] + turned @ read[7:]))


def test_readings_change_with_gains_as_those_of_a_turned_sensor_do() -> None:
    observer, pose = ModalObserver(small_model(), GAINED), np.array([0.4, -0.7])
    x, after, read = np.zeros(len(observer.state)), np.zeros(len(observer.state)), np.zeros(10)
    x[:2] = pose
    _, H = observer.linearised(pose)
    next_and_read(observer.constants, observer.scheduled, x, np.zeros(2), after, read)
    first = observer.state_names.index("turn_x_imu_x")
    by_gains = H[:, first : first + 7] @ GAINS
    np.testing.assert_allclose(by_gains, wrongly(read) - read, atol=2.0 * 9.81 * float(GAINS @ GAINS))  # the turn's second order
    assert np.abs(by_gains).max() > 0.015
    link = observer.state_names.index("offset_link_propeller")
    np.testing.assert_allclose(H[:, link : link + 2], np.eye(10)[:, 2:4], atol=1e-9)


@pytest.mark.parametrize("kind", ["kf", "ekf", "ukf"])
def test_turned_and_scaled_sensors_leave_their_filter_consistent(kind: FilterKind) -> None:
    squares, nis = [], {"told": [], "untold": []}
    for seed in range(6):
        measured, commands, _ = drawn_rows(DenseModel(small_model(), small_noise()), small_noise(), 512, seed=seed)
        gains = GAINED.initial_gain * np.random.default_rng(100 + seed).standard_normal(7)
        measured = np.array([wrongly(row, gains) for row in measured])
        for name, noise in (("told", replace(small_noise(), initial_gain=GAINED.initial_gain)), ("untold", small_noise())):
            observer = ModalObserver(small_model(), noise, kind)
            summary = observer.likelihood(measured, commands)[1]
            nis[name].append(summary[:, 0].sum() / summary[:, 1].sum())
        observer = ModalObserver(small_model(), replace(small_noise(), initial_gain=GAINED.initial_gain), kind)
        for row, command in zip(measured, commands, strict=True):
            observer.step_measured(row, command)
        first = observer.state_names.index("turn_x_imu_x")
        error = observer.state[first : first + 7] - gains
        squares.append(error @ np.linalg.solve(observer.covariance[first : first + 7, first : first + 7], error) / 7.0)
    assert np.mean(nis["told"]) == pytest.approx(1.0, abs=0.05)
    assert np.mean(nis["untold"]) > 1.2
    assert 0.5 < np.mean(squares) < 1.7  # of 42 degrees of freedom


def test_gains_that_do_not_fit_are_one_clear_line() -> None:
    with pytest.raises(DesignError, match="initial_gain must be 7 numbers or none, none negative"):
        ModalObserver(small_model(), replace(small_noise(), initial_gain=np.zeros(6)))
