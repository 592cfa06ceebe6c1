"""The observer's own model with every parameter the emulated C-arm's: its modes, shapes, gravity and places, from its equations."""

from __future__ import annotations

import dataclasses
from itertools import product

import numpy as np
import scipy.linalg

from controllers.models.modal import ModalModel, basis_size, basis_values
from hil.machine import Machine
from hil.observing.noise import effort_gain
from hil.observing.observer_design import axis_grid
from hil.observing.over_poses import harmonics_for
from virtual_bus.physics import Physics
from virtual_bus.plant.linearise import inertia_matrix
from virtual_bus.plant.statics import equilibrium, static_stiffness

GRID = (9, 13)
"""Poses per axis."""

OF_JOINT = {"mount_sway": "mount", "arm_yaw": "mount", "detector_mount": "turn"}
"""Where a joint's disturbance acts, as the observer names it; all others are gears."""

SHAPE_STEP_rad, POINT_STEP_rad = 1e-3, 1e-5


class Emulated:
    """The emulated machine's equations: joints that drives turn, all others springs."""

    def __init__(self, machine: Machine) -> None:
        physics = Physics(machine.plant, noise=False)
        physics.place(np.zeros(len(machine.axes)))
        self.machine, self.plant, self.model = machine, physics.plant, physics.model
        tree = machine.plant.tree
        self.joints = [joint.name for joint in tree.joints]
        self.driven = [tree.joint_index(drive.joint) for drive in machine.plant.drives]
        encoders = {encoder.channel: encoder for encoder in machine.plant.encoders}
        self.links = np.array([
            [float(name in encoders[f"link_position_{axis}"].joints) for name in self.joints] for axis in machine.axes
        ])  # fmt: skip
        watched, detector = list(machine.plant.watched_bodies), machine.geometry.detector_body  # type: ignore[union-attr]
        self.detector = watched.index(detector)
        self.sensed = [self.detector, *(watched.index(imu.body) for imu in machine.plant.imus if imu.body != detector)]
        self.rigid = np.eye(len(self.joints))[:, self.driven]
        self.damping = np.diag([joint.damping for joint in tree.joints])
        self.friction = np.diag(self.damping)[self.driven].copy()
        self.damping[self.driven, self.driven] = 0.0
        self.gain = effort_gain(machine)

    def modes_at(self, pose: np.ndarray, modes: int, like: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """Equilibrium, inertia, ω² and shapes (joints, modes) of unit modal mass beside the axes' rigid motion; signs as a neighbour's."""
        q = equilibrium(self.plant, self.model, pose)
        inertia, stiffness = inertia_matrix(self.plant, self.model, q), static_stiffness(self.plant, self.model, q)
        beside = scipy.linalg.null_space(self.rigid.T @ inertia)
        squares, shapes = scipy.linalg.eigh(beside.T @ (stiffness + stiffness.T) @ beside / 2.0, beside.T @ inertia @ beside)
        found = beside @ shapes[:, :modes]
        if like is not None:
            found = found * np.sign(np.einsum("ij,ij->j", found, inertia @ like))
        return q, inertia, squares[:modes], found

    def detector_at(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.body_at(q, self.detector)

    def body_at(self, q: np.ndarray, body: int) -> tuple[np.ndarray, np.ndarray]:
        pose = self.plant.body_poses(self.model, q)[body]
        return pose[:3], pose[3:].reshape(3, 3)

    def twists(self, q: np.ndarray, body: int) -> np.ndarray:
        """(joints, 6) shift and turn of a body per joint, in its frame."""
        _, turned = self.body_at(q, body)
        rows = []
        for unit in np.eye(len(q)):
            (x, X), (y, Y) = self.body_at(q + POINT_STEP_rad * unit, body), self.body_at(q - POINT_STEP_rad * unit, body)
            turn = X @ Y.T
            turn = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
            rows.append(np.concatenate((turned.T @ (x - y), turned.T @ turn)) / (2.0 * POINT_STEP_rad))
        return np.array(rows)

    def bias(self, q: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """What turning takes (joints,), gravity's part away."""
        return self.plant.inertia_and_bias(self.model, q, speed)[1] - self.plant.inertia_and_bias(self.model, q, 0.0 * speed)[1]


def true_model(machine: Machine, like: ModalModel, modes: int, shaken: tuple[str, ...], counts: tuple[int, ...] = GRID) -> ModalModel:
    """The model with the emulator's parameters.

    Parameters
    ----------
    machine : Machine
    like : ModalModel
        For its chain and sensors.
    modes : int
        How many of the lowest.
    shaken : tuple of str
        Joints at which disturbances act, behind those at the drives.
    counts : tuple of int
        Poses per axis.
    """
    emulated = Emulated(machine)
    grid = np.array(list(product(*(axis_grid(machine, axis, count) for axis, count in enumerate(counts)))))
    harmonics = harmonics_for(grid)
    basis = np.zeros((len(grid), basis_size(harmonics)))
    for row, pose in zip(basis, grid, strict=True):
        basis_values(np.array(harmonics, dtype=np.int64), pose, row)
    places = [*emulated.driven, *(emulated.joints.index(name) for name in shaken)]
    tables: list[tuple[np.ndarray, ...]] = []
    before: dict[int, np.ndarray] = {}
    for index, pose in enumerate(grid):
        column = index % counts[1]
        neighbour = before.get(column - 1) if column else before.get(0)
        q, inertia, squares, shapes = emulated.modes_at(pose, modes, neighbour)
        before[column] = shapes
        tables.append(_at_pose(emulated, pose, q, inertia, squares, shapes, places))
    rows, directions, turning, coupling = (np.array(part) for part in zip(*tables, strict=True))

    def written(values: np.ndarray) -> np.ndarray:
        found = np.linalg.lstsq(basis, values.reshape(len(grid), -1), rcond=1e-10)[0].T
        return np.ascontiguousarray(found.reshape(*values.shape[1:], -1))

    return dataclasses.replace(
        like, harmonics=harmonics, coefficients=written(rows), directions=written(directions), turning=written(turning),
        coupling=written(coupling), places=("drive",) * len(machine.axes) + tuple(OF_JOINT.get(name, "gear") for name in shaken),
    )  # fmt: skip


def _at_pose(
    emulated: Emulated, pose: np.ndarray, q: np.ndarray, inertia: np.ndarray, squares: np.ndarray, shapes: np.ndarray, places: list[int]
) -> tuple[np.ndarray, ...]:
    """Rows, directions, turning and coupling at one pose."""
    n, modes, gain, rigid = len(pose), len(squares), emulated.gain, emulated.rigid
    own = np.linalg.inv(rigid.T @ inertia @ rigid)
    twist = np.vstack([emulated.twists(q, body).T @ shapes for body in emulated.sensed])
    motor, link, inputs = shapes[emulated.driven], emulated.links @ shapes, gain[:, None] * shapes[emulated.driven]
    held = emulated.plant.inertia_and_bias(emulated.model, q, 0.0 * q)[1]
    rows: list[np.ndarray] = []
    for k, square in enumerate(squares):
        loss = shapes[:, k] @ emulated.damping @ shapes[:, k] / square
        rows.append(np.concatenate(([1.0 / square, loss], motor[:, k], link[:, k], twist[:, k], inputs[:, k] / square)))
    bent = q.copy()
    bent[emulated.driven] -= pose
    bends = shapes.T @ inertia @ bent - inputs.T @ (held[emulated.driven] / gain) / squares
    at_links = np.zeros(len(q))
    at_links[emulated.driven] = emulated.links @ q
    (there, _), (here, turned) = emulated.detector_at(at_links), emulated.detector_at(q)
    offset = np.concatenate((turned.T @ (here - there), np.zeros(3)))
    rows += [(own * gain).ravel(), emulated.friction / gain, -own @ rigid.T @ held, bends, offset]
    directions = np.column_stack([np.concatenate((own @ rigid.T[:, j], shapes[j] / squares)) for j in places])
    pairs = [(j, k) for j in range(n) for k in range(j, n)]
    alone = [emulated.bias(q, rigid[:, j]) for j in range(n)]
    pushed = [
        alone[j] if j == k else emulated.bias(q, rigid[:, j] + rigid[:, k]) - alone[j] - alone[k] for j, k in pairs
    ]  # fmt: skip
    turning = -np.column_stack([np.concatenate((own @ rigid.T @ push, shapes.T @ push / squares)) for push in pushed])
    coupling = np.zeros((n, n, modes))
    for axis, step in enumerate(SHAPE_STEP_rad * np.eye(n)):
        more, less = (emulated.modes_at(pose + sign * step, modes, shapes)[3] for sign in (1.0, -1.0))
        slope = (more - less) / (2.0 * SHAPE_STEP_rad)
        for k in range(modes):
            together = emulated.bias(q, rigid[:, axis] + shapes[:, k]) - alone[axis] - emulated.bias(q, shapes[:, k])
            coupling[axis, :, k] = -own @ rigid.T @ (2.0 * inertia @ slope[:, k] + together)
    return np.concatenate(rows), directions, turning, coupling
