"""Lost samples, seen in recordings whose losses are known."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis.dropout import by_sensor, without_lost_samples

CHANNELS = ("link_position_arm", "imu_x", "gyro_x")
ROWS = 4000


def recorded(share, length, channels, seed=0):
    """(R, N, C) noisy channels of which some hold their last reading, and the (N, C) simulation."""
    random = np.random.default_rng(seed)
    time_s = np.arange(ROWS) / 200.0
    simulated = np.column_stack([np.sin(2.0 * np.pi * f * time_s) for f in (1.0, 3.0, 2.0)])
    measured = simulated + 1e-3 * random.standard_normal((3, ROWS, 3))
    for r in range(3):
        for c in channels:
            lost = np.repeat(random.random(ROWS // length) < share, length)
            for k in np.flatnonzero(lost[1:]) + 1:
                measured[r, k, c] = measured[r, k - 1, c]
    return measured, simulated


def test_the_share_that_is_lost_is_measured_and_taken_out():
    measured, simulated = recorded(0.06, 1, [0])
    kept, lost = without_lost_samples(measured, simulated, CHANNELS)
    assert set(lost) == {"link_position_arm"}
    found = lost["link_position_arm"]
    assert found.ci95[0] < 0.06 < found.ci95[1]
    assert found.length == pytest.approx(1.0, abs=0.15)
    repeats = np.diff(measured[:, :, 0], axis=1) == 0.0
    assert np.isnan(kept[:, 1:, 0][repeats]).all()
    assert np.isfinite(kept[:, :, 1:]).all()


def test_bursts_have_their_length():
    _, lost = without_lost_samples(*recorded(0.05, 4, [1]), CHANNELS)
    assert lost["imu_x"].length == pytest.approx(4.0, rel=0.3)


def test_an_imu_that_loses_samples_is_named_once():
    _, lost = without_lost_samples(*recorded(0.05, 1, [1, 2]), CHANNELS)
    assert set(by_sensor(lost)) == {"imu"}


def test_a_lattice_and_noise_repeat_readings_without_a_loss():
    measured, simulated = recorded(0.0, 1, [])
    coarse = np.round(measured / 5e-3) * 5e-3
    kept, lost = without_lost_samples(coarse, simulated, CHANNELS)
    assert not lost
    np.testing.assert_array_equal(kept, coarse)


def test_a_joint_that_sticks_while_its_simulation_moves_loses_nothing():
    _, simulated = recorded(0.0, 1, [])
    lattice = 1e-5
    stuck = np.round(np.clip(simulated, -0.6, 0.6) / lattice) * lattice
    kept, lost = without_lost_samples(np.stack([stuck] * 3), simulated, CHANNELS)
    assert not lost
    assert np.isfinite(kept).all()
