"""Directions of disturbances: at the drives, in the gears, and between link side and detector, each in one direction of all modes together.

A disturbance that acts on every mode independently may move the detector in ways that no push at a real place could. By reciprocity a push
moves a mode in proportion to the mode's motion where it acts, divided by the modal mass; and the mass follows from a drive's push on a mode
and the mode's motion at that drive. So places at which the modes' shapes are known need nothing but the identified model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.models.modal import ModalModel, basis_at, chain_at_rest

MASS_HARMONICS = 1
"""Modal masses vary with pose as inertias do, but weak modes show theirs at few poses only."""

LEAST_SHARE = 0.01
"""Directions with less than this share of the softest one's compliance between link side and detector are left out."""


@dataclass(frozen=True)
class Shapes:
    """The modes' shapes at one pose.

    Attributes
    ----------
    pose : (n_axes,)
    stiffness : (modes,) ω²
    motor, link : (modes, n_axes)
    relative : (modes, 6) the detector's shift and turn against where the link sides put it, in its frame
    inputs : (modes, n_axes)
    rigid : (n_axes, n_axes) B_r
    """

    pose: np.ndarray
    stiffness: np.ndarray
    motor: np.ndarray
    link: np.ndarray
    relative: np.ndarray
    inputs: np.ndarray
    rigid: np.ndarray


def shapes_at(model: ModalModel, pose: np.ndarray) -> Shapes:
    """Return the modes' shapes at a pose (n_axes,)."""
    pose = np.asarray(pose, float)
    n, modes, stride = len(model.axes), model.modes, model.mode_stride
    values = model.at(pose)
    table = values[: modes * stride].reshape(modes, stride)
    sensor = model.sensors[0]
    rest = chain_at_rest(model.chain, model.sensors[:1], pose)
    turn = sensor.rotation @ rest.speed[3:6]
    shift = sensor.rotation @ rest.acceleration[:3] - np.cross(turn.T, sensor.sensor_end_m - sensor.body_end_m).T
    link = table[:, 2 + n : 2 + 2 * n]
    relative = table[:, 2 + 2 * n : 8 + 2 * n] - link @ np.vstack((shift, turn)).T
    rigid = values[modes * stride :][: n * n].reshape(n, n)
    return Shapes(pose, table[:, 0], table[:, 2 : 2 + n], link, relative, table[:, -n:], rigid)


def with_directions(model: ModalModel, poses: Sequence[np.ndarray], effort_gain: np.ndarray) -> ModalModel:
    """Return the model with a direction for every place: drives, gears, turns and shifts of the detector against the link side.

    Parameters
    ----------
    model : ModalModel
    poses : sequence of (n_axes,) arrays
        At which it was identified.
    effort_gain : (n_axes,) array
        Force or torque on the joint per unit of the drive.

    Returns
    -------
    ModalModel
        Its disturbances: the drives' in drive's units, the gears', the turns' in Nm, the shifts' in N.
    """
    n, modes = len(model.axes), model.modes
    seen = [shapes_at(model, pose) for pose in poses]
    masses = _inverse_masses(model, seen, effort_gain)
    turns, shifts = soft_directions(seen, masses)
    rows = []
    for here, inverse in zip(seen, masses, strict=True):
        columns = [np.concatenate((here.rigid[:, k], here.inputs[:, k] / here.stiffness)) for k in range(n)]
        pushes = [here.link[:, k] - here.motor[:, k] for k in range(n)]
        pushes += [here.relative[:, 3:] @ direction for direction in turns] + [here.relative[:, :3] @ direction for direction in shifts]
        columns += [np.concatenate((np.zeros(n), inverse * push / here.stiffness)) for push in pushes]
        rows.append(np.column_stack(columns))
    table = np.array(rows)
    basis = basis_at(model.harmonics, [here.pose for here in seen])
    directions = np.linalg.lstsq(basis, table.reshape(len(seen), -1), rcond=1e-8)[0].T
    places = ("drive",) * n + ("gear",) * n + ("turn",) * len(turns) + ("shift",) * len(shifts)
    return replace(model, directions=np.ascontiguousarray(directions.reshape(n + modes, -1, basis.shape[1])), places=places)


def drives_masses(seen: Sequence[Shapes], effort_gain: np.ndarray) -> np.ndarray:
    """Return inverse masses (poses, modes), from every pose by itself: exact except for modes that hardly move a drive."""
    push, given = np.array([here.motor * effort_gain for here in seen]), np.array([here.inputs for here in seen])
    share: np.ndarray = np.sum(push * given, axis=2) / np.sum(push**2, axis=2)
    return share


def _inverse_masses(model: ModalModel, seen: Sequence[Shapes], effort_gain: np.ndarray) -> np.ndarray:
    """Return inverse modal masses (poses, modes).

    A drive's push on a mode is its gain times the mode's motion at the drive over the modal mass.
    """
    push = np.array([here.motor * effort_gain for here in seen])
    given = np.array([here.inputs for here in seen])
    basis = basis_at([min(order, MASS_HARMONICS) for order in model.harmonics], [here.pose for here in seen])
    masses = np.zeros(push.shape[:2])
    for i in range(push.shape[1]):
        system = (push[:, i, :, None] * basis[:, None, :]).reshape(-1, basis.shape[1])
        fitted = basis @ np.linalg.lstsq(system, given[:, i].ravel(), rcond=1e-6)[0]
        overall = np.sum(push[:, i] * given[:, i]) / np.sum(push[:, i] ** 2)
        masses[:, i] = np.clip(fitted, 0.3 * overall, 3.0 * overall)
    return masses


def soft_directions(seen: Sequence[Shapes], masses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit turns (k, 3) and shifts (l, 3) of the detector against the link side: the softest ones over all poses.

    They are in the detector's frame.
    """
    compliance = np.zeros((6, 6))
    for here, inverse in zip(seen, masses, strict=True):
        compliance += (here.relative.T * (inverse / here.stiffness)) @ here.relative
    kept = []
    for block in (compliance[3:, 3:], compliance[:3, :3]):
        softness, directions = np.linalg.eigh(block)
        kept.append(directions.T[softness >= LEAST_SHARE * softness.max()])
    return kept[0], kept[1]
