"""What an inertial sensor on the panel measures by the swinging chain, against MuJoCo's sensors and the chain's own differences."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from flexible_machine import soft_machine
from scipy.linalg import expm

from controllers.models.swinging_chain import PanelImu, Readings, readings, swing_step
from hil.calibration.kinematic.nominal_chain import nominal_chain
from hil.machine.mjcf import to_mjcf

MACHINE = soft_machine()
CHAIN = nominal_chain(MACHINE)
GRAVITY = np.array([0.0, 0.0, -9.81])
RNG = np.random.default_rng(5)
POSITIONS = RNG.uniform([-2.0, -1.5], [2.0, 1.5], (8, 2))
SPEEDS, ACCELERATIONS = RNG.normal(0.0, [0.5, 0.6], (8, 2)), RNG.normal(0.0, [1.0, 1.5], (8, 2))
IMU = PanelImu(MACHINE.plant.imus[0].position_m - MACHINE.geometry.detector_center_m, MACHINE.plant.imus[0].orientation)


def along(chain: object, positions: np.ndarray = POSITIONS, speeds: np.ndarray = SPEEDS, moved: np.ndarray = ACCELERATIONS) -> Readings:
    return readings(chain, IMU, positions, speeds, moved, GRAVITY)


def in_mujoco(swing: np.ndarray, swing_speed: np.ndarray, swing_acceleration: np.ndarray) -> np.ndarray:
    """Accelerometer and gyroscope (N, 6) of the machine with its joints moved like this, no spring asked."""
    model = mujoco.MjModel.from_xml_string(to_mjcf(MACHINE.plant, "moved"))
    data = mujoco.MjData(model)
    driven = {drive.joint: k for k, drive in enumerate(MACHINE.plant.drives)}
    elastic = {joint.name: k for k, joint in enumerate(CHAIN.elastic)}
    rows = []
    for i in range(len(POSITIONS)):
        data.qpos[:], data.qvel[:], data.qacc[:] = 0.0, 0.0, 0.0
        for joint in MACHINE.plant.tree.joints:
            position, speed = model.joint(joint.name).qposadr[0], model.joint(joint.name).dofadr[0]
            if joint.name in driven:
                k = driven[joint.name]
                data.qpos[position], data.qvel[speed], data.qacc[speed] = POSITIONS[i, k], SPEEDS[i, k], ACCELERATIONS[i, k]
            elif joint.name in elastic:
                k = elastic[joint.name]
                data.qpos[position], data.qvel[speed], data.qacc[speed] = swing[i, k], swing_speed[i, k], swing_acceleration[i, k]
        mujoco.mj_inverse(model, data)
        rows.append(np.concatenate([data.sensor("imu").data, data.sensor("gyro").data]))
    return np.array(rows)


def test_a_stiff_machine_s_sensor_reads_what_mujoco_s_reads() -> None:
    stiff = replace(CHAIN, compliance=0.0 * CHAIN.compliance)
    still = np.zeros((8, len(CHAIN.elastic)))
    expected = in_mujoco(still, still, still)
    found = along(stiff).values
    assert np.ptp(expected[:, 3:]) > 0.5
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=2e-6)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], atol=2e-6)


def test_swinging_joints_add_what_they_add_in_mujoco() -> None:
    stiff = along(replace(CHAIN, compliance=0.0 * CHAIN.compliance))
    size = 1e-5
    three = [size * RNG.normal(size=(8, len(CHAIN.elastic))) * scale for scale in (1.0, 30.0, 1000.0)]
    still = np.zeros_like(three[0])
    added = (in_mujoco(*three) - in_mujoco(*(-each for each in three))) / 2.0
    found = sum(
        np.einsum("nij,nj->ni", slope[:, :, 2:], each)
        for slope, each in zip((stiff.by_position, stiff.by_speed, stiff.by_acceleration), three, strict=True)
    )
    assert np.abs(added).max() > 1e-3
    np.testing.assert_allclose(found, added, atol=2e-6)
    assert np.abs(in_mujoco(*three) - in_mujoco(still, still, still) - added).max() < 1e-4


@pytest.mark.parametrize("what", ["position", "speed", "acceleration"])
def test_the_axes_slopes_are_differences_of_the_readings(what: str) -> None:
    table = along(CHAIN)
    slopes = {"position": table.by_position, "speed": table.by_speed, "acceleration": table.by_acceleration}[what]
    for axis in range(2):
        step = np.zeros((8, 2))
        step[:, axis] = 1e-4
        states = {"position": POSITIONS, "speed": SPEEDS, "acceleration": ACCELERATIONS}
        ends = []
        for sign in (1.0, -1.0):
            moved = dict(states)
            moved[what] = states[what] + sign * step
            ends.append(along(CHAIN, *moved.values()).values)
        slope = (ends[0] - ends[1]) / 2e-4
        np.testing.assert_allclose(slopes[:, :, axis], slope, atol=1e-4 + 1e-4 * np.abs(slope).max())


def test_every_parameter_s_slope_is_a_difference_of_the_readings() -> None:
    slopes, values = along(CHAIN).by_parameter, CHAIN.values
    for k, name in enumerate(CHAIN.names):
        step = np.zeros(len(values))
        step[k] = 1e-5 if k < len(values) - len(CHAIN.elastic) else 1e-2 * values[k]
        ahead, behind = (along(CHAIN.with_values(values + sign * step)).values for sign in (1.0, -1.0))
        slope = (ahead - behind) / (2.0 * step[k])
        np.testing.assert_allclose(slopes[:, :, k], slope, atol=2e-4 + 2e-3 * np.abs(slope).max(), err_msg=name)


def test_a_mode_s_step_is_the_matrix_exponential() -> None:
    omega, damping, seconds = np.array([50.0, 88.0]), np.array([0.02, 0.3]), 0.011
    phi, gamma = swing_step(omega, damping, seconds)
    for k in range(2):
        whole = np.zeros((3, 3))
        whole[:2] = [[0.0, 1.0, 0.0], [-(omega[k] ** 2), -2.0 * damping[k] * omega[k], 1.0]]
        exact = expm(whole * seconds)
        np.testing.assert_allclose(phi[k], exact[:2, :2], rtol=1e-9)
        np.testing.assert_allclose(gamma[k], exact[:2, 2], rtol=1e-9)
