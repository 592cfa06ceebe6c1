"""The observer's model with a machine file's own numbers: modes, shapes, gravity, turning and places, from the plant's equations.

What identification finds from recordings of many poses, a file states: its springs and masses. Effects that no modal model can have in it
are left out here and counted in the noise (`unmodelled`).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import scipy.linalg

from controllers.models.modal import ModalModel, basis_at
from hil.machine import Machine
from hil.observing.geometry import observed_chain, placed_bodies
from hil.observing.noise import effort_gain
from hil.observing.over_poses import axis_grid, harmonics_for
from virtual_bus.effects.places import spring_at
from virtual_bus.physics import Physics
from virtual_bus.plant.linearise import inertia_matrix
from virtual_bus.plant.statics import equilibrium, static_stiffness

SHAPE_STEP_rad, POINT_STEP_rad = 1e-3, 1e-5


class Emulated:
    """The emulated machine's equations: joints that drives turn, all others springs."""

    def __init__(self, machine: Machine) -> None:
        geometry, imus = machine.geometry, machine.plant.imus
        assert geometry is not None
        detector = geometry.detector_body
        seen = (detector, *(imu.body for imu in imus if imu.body != detector))
        settings = replace(machine.plant, watched_bodies=tuple(dict.fromkeys((*machine.plant.watched_bodies, *seen))))
        physics = Physics(settings, noise=False)
        self.machine, self.plant, self.model = machine, physics.plant, physics.model
        tree = machine.plant.tree
        self.joints = [joint.name for joint in tree.joints]
        self.driven = [tree.joint_index(drive.joint) for drive in machine.plant.drives]
        encoders = {encoder.channel: encoder for encoder in machine.plant.encoders}
        self.links = np.array([
            [float(name in encoders[f"link_position_{axis}"].joints) for name in self.joints] for axis in machine.axes
        ])  # fmt: skip
        self.rigid = np.eye(len(self.joints))[:, self.driven]
        self.damping = np.diag([joint.damping for joint in tree.joints])
        self.friction = np.diag(self.damping)[self.driven].copy()
        self.damping[self.driven, self.driven] = 0.0
        placed, centers = (
            placed_bodies(tree.bodies),
            {detector: geometry.detector_center_m, geometry.source_body: geometry.source_position_m},
        )
        self.bodies = [
            (settings.watched_bodies.index(body), centers.get(body, np.zeros(3)), placed[body][1].T @ placed[detector][1]) for body in seen
        ]

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

    def body_at(self, q: np.ndarray, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Position and rotation of the centre of an observed body, whose axes are the detector's where all joints are at zero."""
        watched, center, aligned = self.bodies[body]
        pose = self.plant.body_poses(self.model, q)[watched]
        rotation = pose[3:].reshape(3, 3)
        return pose[:3] + rotation @ center, rotation @ aligned

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
        """Return what turning takes (joints,), gravity's part away."""
        taken: np.ndarray = (
            self.plant.inertia_and_bias(self.model, q, speed)[1] - self.plant.inertia_and_bias(self.model, q, 0.0 * speed)[1]
        )
        return taken

    @property
    def springs(self) -> dict[str, str]:
        """Where the disturbance of each sprung joint acts, as the observer names it.

        That is a gear, the mount before the first axis, or a turn behind it.
        """
        settings = self.machine.plant
        gears = {spring_at(axis, settings) for axis in self.machine.axes}
        parents = {body.name: body.parent for body in settings.tree.bodies}
        first = next(body.name for body in settings.tree.bodies if body.joint and body.joint.name == self.joints[self.driven[0]])
        before = set()
        while first in parents:
            first = parents[first]
            before.add(first)
        sprung = [(body.name, body.joint.name) for body in settings.tree.bodies if body.joint and body.joint.stiffness > 0.0]
        return {
            joint: "gear" if joint in gears else "mount" if body in before else "turn"
            for body, joint in sprung
            if joint not in {self.joints[k] for k in self.driven}
        }


def own_model(machine: Machine, modes: int, counts: tuple[int, ...], shaken: tuple[str, ...] = ()) -> ModalModel:
    """Return the model with the file's own numbers.

    Parameters
    ----------
    machine : Machine
        Without effects that no modal model can have.
    modes : int
        How many of the lowest, at most as many as there are springs.
    counts : tuple of int
        Poses per axis.
    shaken : tuple of str
        Joints at which disturbances act, behind those at the drives; every spring unless given.
    """
    emulated = Emulated(machine)
    springs = emulated.springs
    modes, shaken = min(modes, len(springs)), shaken or tuple(springs)
    grid = np.array(list(product(*(axis_grid(machine, axis, count) for axis, count in enumerate(counts)))))
    harmonics = harmonics_for(grid)
    basis = basis_at(harmonics, grid)
    places = [*emulated.driven, *(emulated.joints.index(name) for name in shaken)]
    tables: list[tuple[np.ndarray, ...]] = []
    known: dict[tuple[int, ...], np.ndarray] = {}
    for index, pose in zip(np.ndindex(counts), grid, strict=True):
        near = list(index)
        if any(near):  # the pose one step back along the last axis that has left its start
            last = max(axis for axis, step in enumerate(near) if step)
            near[last] -= 1
        q, inertia, squares, shapes = emulated.modes_at(pose, modes, known.get(tuple(near)))
        known[index] = shapes
        tables.append(_at_pose(emulated, pose, q, inertia, squares, shapes, places))
    rows, directions, turning, coupling = (np.array(part) for part in zip(*tables, strict=True))

    def written(values: np.ndarray) -> np.ndarray:
        found = np.linalg.lstsq(basis, values.reshape(len(grid), -1), rcond=1e-10)[0].T
        return np.ascontiguousarray(found.reshape(*values.shape[1:], -1))

    chain, sensors, source, _ = observed_chain(machine)
    return ModalModel(
        axes=machine.axes, chain=chain, sensors=sensors, source_end_m=source, harmonics=harmonics, coefficients=written(rows),
        sample_rate_Hz=machine.sample_rate_Hz, effort_limit=np.array([drive.limit for drive in machine.plant.drives]),
        effort_step=np.array([drive.resolution for drive in machine.plant.drives]),
        position_unit=tuple(units.position for units in machine.units), directions=written(directions), turning=written(turning),
        coupling=written(coupling), places=("drive",) * len(machine.axes) + tuple(springs[name] for name in shaken),
    )  # fmt: skip


def _at_pose(
    emulated: Emulated, pose: np.ndarray, q: np.ndarray, inertia: np.ndarray, squares: np.ndarray, shapes: np.ndarray, places: list[int]
) -> tuple[np.ndarray, ...]:
    """Rows, directions, turning and coupling at one pose."""
    n, modes, gain, rigid = len(pose), len(squares), effort_gain(emulated.machine), emulated.rigid
    own = np.linalg.inv(rigid.T @ inertia @ rigid)
    twist = np.vstack([emulated.twists(q, body).T @ shapes for body in range(len(emulated.bodies))])
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
    (there, _), (here, turned) = emulated.body_at(at_links, 0), emulated.body_at(q, 0)
    offset = np.concatenate((turned.T @ (here - there), np.zeros(3)))
    rows += [(own * gain).ravel(), emulated.friction / gain, -own @ rigid.T @ held, bends, offset]
    directions = np.column_stack([np.concatenate((own @ rigid.T[:, j], shapes[j] / squares)) for j in places])
    directions[:, :n] *= gain  # a drive's disturbance is in its unit
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
