"""What encoders say of an IMU, against an arm in closed form."""

from __future__ import annotations

import numpy as np
import scipy.signal
from places import CONCEALED_MACHINES

from hil.diagnosis.residuals.carried import carried_imu
from hil.machine import load_machine

ARM = load_machine(CONCEALED_MACHINES / "tilted_arm.toml")
CHANNELS = ("current_arm", "imu_x", "position_arm", "imu_z", "link_position_arm", "gyro_y")
RATE_Hz, ROWS = 200.0, 2000
OUT_m, UP_m = 0.5, 0.03  # of the IMU from the joint's axis
TILT = np.deg2rad(35.0)  # of the axis; the axis is y


def readings(angle):
    """(N, 3) imu_x, imu_z, gyro_y of a turn about y by `angle`: gravity's share across the axis, and the motion of a point on the arm."""
    speed = np.gradient(angle, 1.0 / RATE_Hz)
    acceleration = np.gradient(speed, 1.0 / RATE_Hz)
    up = 9.81 * np.cos(TILT)
    x = -up * np.sin(angle) - OUT_m * speed**2 + UP_m * acceleration
    z = up * np.cos(angle) - OUT_m * acceleration - UP_m * speed**2
    return np.column_stack([x, z, speed])


def channels(angle):
    x, z, gyro = readings(angle).T
    return np.column_stack([np.zeros_like(angle), x, angle, z, angle, gyro])


def motion_and_error():
    time_s = np.arange(ROWS) / RATE_Hz
    slow = scipy.signal.butter(3, 3.0, fs=RATE_Hz, output="sos")
    error = 1e-3 * scipy.signal.sosfiltfilt(slow, np.random.default_rng(0).standard_normal(ROWS))
    return 1.2 * np.sin(2.0 * np.pi * 0.3 * time_s), error


def test_a_deviation_that_the_encoder_shows_is_taken_out_of_the_imu():
    motion, error = motion_and_error()
    felt = channels(motion + error) - channels(motion)
    found = carried_imu(ARM, CHANNELS, motion[:, None])
    assert found is not None
    left = found.without(felt)
    inner = slice(20, -20)
    for name in ("imu_x", "imu_z", "gyro_y"):
        column = CHANNELS.index(name)
        assert np.std(left[inner, column]) < 0.05 * np.std(felt[inner, column]), name
    for name in ("current_arm", "position_arm", "link_position_arm"):
        np.testing.assert_array_equal(left[:, CHANNELS.index(name)], felt[:, CHANNELS.index(name)])


def test_what_the_encoder_does_not_show_stays():
    motion, _ = motion_and_error()
    felt = channels(motion)
    found = carried_imu(ARM, CHANNELS, motion[:, None])
    assert found is not None
    own = np.zeros_like(felt)
    own[:, CHANNELS.index("imu_x")] = np.random.default_rng(1).standard_normal(ROWS)
    own[:, CHANNELS.index("position_arm")] = 1.0  # the link's own encoder is nearer to the IMU
    np.testing.assert_allclose(found.without(felt + own) - found.without(felt), own, atol=1e-9)


def test_without_an_imu_or_an_encoder_there_is_nothing_to_take_out():
    still = np.zeros((100, 1))
    assert carried_imu(ARM, ("current_arm", "link_position_arm"), still) is None
    assert carried_imu(ARM, ("current_arm", "imu_x"), still) is None
