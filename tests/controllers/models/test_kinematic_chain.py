"""The chain's poses are those of MuJoCo's, its rows are (2.7) corrected, and its derivatives are those of its poses."""

from __future__ import annotations

import mujoco
import numpy as np
from chains import IDENTIFIED, NOMINAL
from scipy.spatial.transform import Rotation

from controllers.models.denavit_hartenberg import DenavitHartenberg
from hil.calibration.kinematic.identify_denavit_hartenberg import pose_difference


def quaternion(*turns: tuple[str, float]) -> str:
    """MuJoCo's w, x, y, z of rotations about given axes, one after the other in the moving frame."""
    total = Rotation.identity()
    for axis, angle in turns:
        total = total * Rotation.from_euler(axis, angle)
    return " ".join(f"{value:.17g}" for value in total.as_quat(scalar_first=True))


def in_mujoco(chain: DenavitHartenberg, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses of the phantom in the detector's frame, by MuJoCo."""
    u, v, y, z = chain.frame_angles
    text, close = f'<body quat="{quaternion(("x", u), ("y", v))}">', "</body>"
    for a, offset, alpha, d, _ in chain.table:
        text += f'<body quat="{quaternion(("z", offset))}"><joint axis="0 0 1"/><geom size="0.01"/>'
        text += f'<body pos="{a:.17g} 0 {d:.17g}" quat="{quaternion(("x", alpha))}">'
        close += "</body></body>"
    text += f'<body name="phantom" quat="{quaternion(("y", y), ("z", z))}"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{text}{close}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    positions, rotations = [], []
    for row in angles:
        data.qpos[:] = row * chain.table[:, 4]
        mujoco.mj_kinematics(model, data)
        positions.append(data.body("phantom").xpos.copy())
        rotations.append(data.body("phantom").xmat.reshape(3, 3).copy())
    return np.array(positions), np.array(rotations)


def test_poses_are_mujoco_s() -> None:
    angles = np.random.default_rng(1).uniform(-2.0, 2.0, (30, 4))
    position, rotation = IDENTIFIED.poses(angles)
    expected_position, expected_rotation = in_mujoco(IDENTIFIED, angles)
    np.testing.assert_allclose(position, expected_position, atol=1e-12)
    np.testing.assert_allclose(rotation, expected_rotation, atol=1e-12)


def test_a_row_is_the_thesis_s_matrix_with_its_third_row_corrected() -> None:
    a, offset, alpha, d, beta = IDENTIFIED.table[3]
    one = type(NOMINAL)(("only",), IDENTIFIED.table[3:], np.zeros(4))
    theta = offset + 0.7 * beta
    position, rotation = one.poses(np.array([[0.7]]))
    c, s = np.cos(theta), np.sin(theta)
    ca, sa = np.cos(alpha), np.sin(alpha)
    np.testing.assert_allclose(rotation[0], [[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]], atol=1e-15)
    np.testing.assert_allclose(position[0], [a * c, a * s, d], atol=1e-15)


def test_derivatives_are_those_of_the_poses() -> None:
    angles = np.random.default_rng(2).uniform(-2.0, 2.0, (7, 4))
    jacobian = IDENTIFIED.jacobian(angles)
    step = 1e-6
    for k, name in enumerate(IDENTIFIED.names):
        there, back = IDENTIFIED.values, IDENTIFIED.values
        there[k] += step
        back[k] -= step
        slope = pose_difference(*IDENTIFIED.with_values(there).poses(angles), *IDENTIFIED.with_values(back).poses(angles)) / (2.0 * step)
        np.testing.assert_allclose(jacobian[:, :, k], slope, atol=1e-8, err_msg=name)
