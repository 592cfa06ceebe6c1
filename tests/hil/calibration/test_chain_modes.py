"""A chain's file with its modes: gravity at its elastic joints against MuJoCo and a potential, and what a wrong file is told."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.calibration.parameter_states.chain_modes import read_swinging
from hil.calibration.parameter_states.filter_model import SwingingMachine
from hil.errors import UnusableInputError

CHAINS = Path(__file__).parents[3] / "benchmarks" / "chains"
START = read_swinging(CHAINS / "table_2_1.toml")
MODES = (  # mass, its centre in the panel's frame with the axes at zero, row, axis, point: as in the file
    (40.0, np.array([0.05, 0.02, -0.05]), 0, np.array([0.4, 0.9165, 0.0]), np.array([0.0, 0.0, -0.15])),
    (200.0, np.array([0.1, 0.3, 0.4]), 3, np.array([0.0, 0.0, 1.0]), np.zeros(3)),
)
ASKEW = np.random.default_rng(8).uniform(-1.0, 1.0, (4, 4)) * [0.05, 0.3, 0.3, 0.05]
"""How far the rows' lengths and angles are from the table's in a file made askew: a, delta_theta, alpha, d."""


def placed(axis: int, angle: float = 0.0, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    result[:3, 3] = shift
    return result


def rows_of(machine: SwingingMachine) -> list[np.ndarray]:
    """(2.7) row by row with the joints at zero, between the panel's turns and the phantom's (2.12)."""
    theta_u, theta_v, theta_y, theta_z = machine.chain.chain.frame_angles
    rows = [placed(2, turn) @ placed(2, 0.0, (a, 0.0, d)) @ placed(0, alpha) for a, turn, alpha, d, _ in machine.chain.chain.table]
    return [placed(0, theta_u) @ placed(1, theta_v), *rows, placed(1, theta_y) @ placed(2, theta_z)]


def in_mujoco(machine: SwingingMachine, positions: np.ndarray, swing: np.ndarray) -> np.ndarray:
    """Efforts (N, 2) of gravity at the elastic joints: from the phantom, the world, body in body out to the panel."""
    rows, inside, outside = rows_of(machine), "", ""

    def body(pose: np.ndarray, hinge: str, mass: float, center: np.ndarray) -> None:
        nonlocal inside, outside
        quat = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)
        inside += f'''<body pos="{text(pose[:3, 3])}" quat="{text(quat)}">{hinge}
            <inertial pos="{text(center)}" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>'''
        outside += "</body>"

    for row in range(5, -1, -1):
        body(np.linalg.inv(rows[row]), f'<joint name="j{row}" axis="0 0 -1"/>' if 1 <= row <= 4 else "", 1e-9, np.zeros(3))
        for number, (mass, center, at, axis, point) in enumerate(MODES):
            if at == row:
                to_panel = reduce(np.matmul, rows[:row], np.eye(4))
                own = np.linalg.inv(to_panel) @ [*center, 1.0]
                body(np.eye(4), f'<joint name="e{number}" axis="{text(axis)}" pos="{text(point)}"/>', mass, own[:3])
    option = f'<compiler angle="radian"/><option gravity="{text(machine.gravity_m_s2)}"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{inside}{outside}</worldbody></mujoco>")
    data, found = mujoco.MjData(model), []
    for q, eta in zip(positions, swing, strict=True):
        for k in range(4):
            data.joint(f"j{k + 1}").qpos[0] = q[k]
        for k in range(2):
            data.joint(f"e{k}").qpos[0] = eta[k]
        mujoco.mj_forward(model, data)
        found.append([-data.joint(f"e{k}").qfrc_bias[0] for k in range(2)])
    return np.array(found)


def text(vector: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in vector)


def askew(tmp_path: Path) -> SwingingMachine:
    """The machine of a file whose rows have odd lengths and angles, and frame angles."""
    start, _, rest = (CHAINS / "table_2_1.toml").read_text().partition("[[joint]]")
    table = START.chain.chain.table[:, :4] + ASKEW
    keys = ("a_m", "delta_theta_rad", "alpha_rad", "d_m")
    joints = [
        "\n".join(["[[joint]]", f'name = "j{k}"', *(f"{key} = {value!r}" for key, value in zip(keys, row, strict=True))])
        for k, row in enumerate(table.tolist(), start=1)
    ]
    frame = "[frame]\ntheta_u_rad = 0.2\ntheta_v_rad = -0.1\ntheta_y_rad = 0.15\ntheta_z_rad = 0.3\n"
    path = tmp_path / "askew.toml"
    path.write_text("\n".join([start, *joints, frame, rest[rest.index("[imu]") :]]))
    return read_swinging(path)


def test_gravity_pulls_at_elastic_joints_as_in_mujoco(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    for machine in (START, askew(tmp_path)):
        positions, swing = rng.uniform(-1.5, 1.5, (8, 4)), rng.normal(0.0, 0.05, (8, 2))
        found = machine.chain.tree.efforts(np.concatenate([positions, swing], axis=1))[:, 4:]
        expected = in_mujoco(machine, positions, swing)
        assert np.ptp(expected, axis=0).min() > 5.0
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_gravity_s_effort_is_the_slope_of_the_potential_of_what_a_joint_carries() -> None:
    chain, positions = START.chain, np.random.default_rng(2).uniform(-1.0, 1.0, (6, 4))
    stiff = replace(chain, compliance=np.full(2, 1e-30))
    _, effort = stiff.deflections(positions)
    as_arm = positions * [0.0, 0.0, 1.0, 1.0]  # the arm stands behind axes 3 and 4 and before 1 and 2: these do not move its own mass
    loads = [(*MODES[0][:2], positions, {0, 1}), (*MODES[1][:2], as_arm, {1})]  # and the joints that carry it
    for joint in range(2):
        slope = np.zeros(6)
        for sign in (1.0, -1.0):
            swing = np.zeros((6, 2))
            swing[:, joint] = sign * 1e-5
            for mass, center, moved, carried in loads:
                if joint in carried:
                    _, phantom, rotation = stiff.poses(moved, swing)
                    place = np.einsum("nij,ni->nj", rotation, center - phantom)
                    slope += sign * mass * (place @ START.gravity_m_s2) / 2e-5
        np.testing.assert_allclose(effort[:, joint], slope, atol=1e-4 * np.abs(slope).max())
        assert np.ptp(slope) > 5.0


def test_the_chain_s_file_names_what_is_wrong(tmp_path: Path) -> None:
    text = (CHAINS / "table_2_1.toml").read_text()
    for old, new, message in (
        ("row = 3", "row = 9", "mode 2: row = 9: must be a whole number from 0, the panel, to 5"),
        ("frequency_Hz = 14.0", "frequency_Hz = -1.0", "mode 1: frequency_Hz = -1.0: must be a positive number"),
        ("damping = 0.01\n", "damping = 1.5\n", "mode 1: damping = 1.5: must be a ratio below 1"),
        ("axis = [0.4, 0.9165, 0.0]", "axis = [0.4, 0.9165]", r"mode 1: axis = \[0.4, 0.9165\]: must be 3 numbers"),
        ('name = "arm"', 'name = "detector_mount"', "mode 2: name = 'detector_mount': must be a text of its own"),
        ("gain_rad_s2 = [0.01, 0.02, 0.02, 0.01]", "gain_rad_s2 = 3", "mode 1: gain_rad_s2 = 3: must be 4 numbers"),
    ):
        assert old in text
        path = tmp_path / "chain.toml"
        path.write_text(text.replace(old, new, 1))
        with pytest.raises(UnusableInputError, match=message):
            read_swinging(path)
    path.write_text(text[: text.index("[[mode]]")])
    with pytest.raises(UnusableInputError, match=r"must have a table \[\[mode\]\]"):
        read_swinging(path)


def test_the_start_is_what_the_file_says() -> None:
    machine: SwingingMachine = START
    assert machine.chain.names[-2:] == ("compliance_detector_mount", "compliance_arm")
    assert machine.dynamic_names[0] == "log_frequency_detector_mount"
    assert machine.gain.shape == (2, 4)
