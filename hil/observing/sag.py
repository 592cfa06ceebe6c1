"""Compliance of a machine's mount under gravity, which no sensor shows at rest, from its compliance under the drives.

A mount that turns about an axis parallel to the first driven one carries what that drive holds: gravity's torque about either axis is the
same except for a constant, and the mount's compliance 1/K makes a turn s of it,

    K s = -h(θ)                                     at rest, h the torque that holds the first axis

Accelerated slowly compared with the modes, it carries the arc's change of angular momentum: the first drive's torque less what its own
rotor takes, and the arc's unbalance on the lever c between the axes. The offset of the arc's centre of mass follows from h itself: m y = h
/ g, so

    K s = -(T δ_1j - J q''_1 + c/g Σ_k ∂h/∂θ_k q''_k),    q'' = B_r w    per unit of drive j

T: torque per unit of the drive; J: its rotor's inertia on the joint. The identified modes give at every pose how far the detector then
moves against the link sides; it moves as a point of a body that turns, so K, J, c follow. A mount turns about the vertical, too: gravity
does not push that turn, and the place of the detector separates the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize
from scipy.spatial.transform import Rotation

from controllers.models.chain import Chain
from controllers.models.modal import ModalModel, basis_at
from hil.observing.directions import shapes_at

TURN_HARMONIC = 2
"""Of the pose, in how the mount turns about the vertical: as inertias vary."""

UPRIGHT = 1e-3
"""How far the first axis may be from horizontal; beyond, gravity pushes the other turn as well."""

STEP_rad = 1e-3
"""Difference step of the holding torque, a trigonometric polynomial of low order: error 1e-6 of it."""

LARGEST_SHARE_LEFT = 0.2
"""Of the detector's motion rms that may stay unexplained."""

LEAST_DEVIATIONS = 5.0
"""How clearly a compliance must stand out: noise of shapes gives one of either sign."""

SHIFT_UNIT_m = 1e-6
LEVER_START_m = 1.0
LEAST_ARM_m = 1e-2
"""Nearer to the vertical axis the detector shows no turn about it, and none is assumed."""


@dataclass(frozen=True)
class Mount:
    """What yields between the ground and the first axis.

    Attributes
    ----------
    compliance : rad per Nm, about an axis parallel to the first driven one.
    lever : m, of that axis above the driven one.
    deviation : of the compliance.
    share_left : rms of what is not explained over rms of the detector's motion against the link sides.
    vertical : m, of the vertical axis about which it turns, along the first driven one.
    """

    compliance: float
    lever: float
    deviation: float
    share_left: float
    vertical: float = 0.0

    @property
    def is_clear(self) -> bool:
        """Whether the compliance exceeds its deviation clearly and explains how the detector moves."""
        return self.compliance > LEAST_DEVIATIONS * self.deviation and self.share_left < LARGEST_SHARE_LEFT

    @property
    def note(self) -> str:
        """Return one line for a design."""
        if not self.is_clear:
            return "the mount's sag is left out: the poses do not tell how it gives way"
        softness, spread = 1e6 * self.compliance, 1e6 * self.deviation
        return f"the mount gives way by {softness:.2g} ± {spread:.1g} µrad per Nm, {self.lever:.2g} m above the first axis"


def with_sag(
    model: ModalModel, poses: Sequence[np.ndarray], standing: Sequence[np.ndarray], effort_gain: np.ndarray
) -> tuple[ModalModel, Mount | None]:
    """Return the model with the detector's shift by the mount's sag; the same model where that is not determined.

    Parameters
    ----------
    model : ModalModel
        With gravity's push on the axes (`standing.with_gravity`).
    poses, standing : sequences of (n_axes,) arrays
        At which it was identified, and at which it stood.
    effort_gain : (n_axes,) array
        Force or torque on the joint per unit of the drive.

    Returns
    -------
    ModalModel
    Mount or None
        None where the first axis is not horizontal or does not turn.
    """
    frame = first_axis_frame(model.chain)
    if frame is None:
        return model, None
    mount = _mount(model, np.asarray(poses, float), effort_gain, frame)
    return (sagging(model, mount, standing, effort_gain) if mount.is_clear else model), mount


def sagging(model: ModalModel, mount: Mount, standing: Sequence[np.ndarray], effort_gain: np.ndarray) -> ModalModel:
    """Return the model with the detector's shift by the sag of this mount."""
    frame = first_axis_frame(model.chain)
    assert frame is not None, "a mount has a horizontal first axis"
    at_rest = np.asarray(standing, float)
    place, turn = detector_places(model, at_rest, frame)
    angle = -mount.compliance * np.array([_holding(model, pose, effort_gain)[0] for pose in at_rest])
    shift = np.column_stack((np.zeros(len(at_rest)), (mount.lever - place[:, 2]) * angle, place[:, 1] * angle))
    rows = np.einsum("pij,pi->pj", turn, shift)
    coefficients = model.coefficients.copy()
    coefficients[-6:-3] = np.linalg.lstsq(basis_at(model.harmonics, at_rest), rows, rcond=1e-8)[0].T
    return replace(model, coefficients=coefficients)


def first_axis_frame(chain: Chain) -> np.ndarray | None:
    """Return rows (3, 3): the first axis, the horizontal beside it, up; None where that axis slides or is not horizontal."""
    up = -chain.gravity_m_s2 / max(float(np.linalg.norm(chain.gravity_m_s2)), 1e-12)
    axis = chain.axes[0] / np.linalg.norm(chain.axes[0])
    if not chain.revolute[0] or not up.any() or abs(axis @ up) > UPRIGHT:
        return None
    return np.vstack((axis, np.cross(up, axis), up))


def _mount(model: ModalModel, poses: np.ndarray, effort_gain: np.ndarray, frame: np.ndarray) -> Mount:
    """Fit compliance, lever, rotor's inertia and the vertical axis's place by least squares; turns about that one are eliminated."""
    n, gravity = len(model.axes), float(np.linalg.norm(model.chain.gravity_m_s2))
    place, turn = detector_places(model, poses, frame)
    harmonics = tuple(min(order, TURN_HARMONIC) for order in model.harmonics)
    basis = basis_at(harmonics, poses)
    moved, rigid, slopes = np.zeros((len(poses), 3, n)), np.zeros((len(poses), n, n)), np.zeros((len(poses), n))
    for i, pose in enumerate(poses):
        here = shapes_at(model, pose)
        moved[i] = turn[i] @ here.relative[:, :3].T @ (here.inputs / here.stiffness[:, None]) / SHIFT_UNIT_m
        rigid[i] = here.rigid
        for k, step in enumerate(STEP_rad * np.eye(n)):
            slopes[i, k] = (_holding(model, pose + step, effort_gain)[0] - _holding(model, pose - step, effort_gain)[0]) / (2.0 * STEP_rad)
    unbalance = np.einsum("pk,pkj->pj", slopes, rigid) / gravity
    given = effort_gain[0] * (np.arange(n) == 0)
    size = effort_gain[0] / np.median(rigid[:, 0, 0])  # the first axis's inertia

    def left(unknown: np.ndarray) -> np.ndarray:
        softness, lever, share, vertical = unknown
        angle = -softness * (given - share * size * rigid[:, 0] + lever * unbalance) / effort_gain[0]
        beside = moved[:, 1] - (lever - place[:, 2])[:, None] * angle
        above = moved[:, 2] - place[:, 1][:, None] * angle
        system = np.concatenate(
            ((place[:, 0] - vertical)[:, None] * basis, -place[:, 1][:, None] * basis, LEAST_ARM_m * np.eye(basis.shape[1]))
        )
        target = np.concatenate((beside, moved[:, 0], np.zeros((basis.shape[1], n))))
        around = target - system @ np.linalg.lstsq(system, target, rcond=None)[0]
        return np.concatenate((above.ravel(), around.ravel()))

    solved = optimize.least_squares(left, np.array([0.1, LEVER_START_m, 0.0, 0.0]), x_scale="jac")
    free = moved.size - n * basis.shape[1] - len(solved.x)
    variance = float(solved.fun @ solved.fun) / max(free, 1) if free > 0 else np.inf
    spread = np.sqrt(variance * np.linalg.pinv(solved.jac.T @ solved.jac)[0, 0])
    unit = SHIFT_UNIT_m / effort_gain[0]
    share = float(np.sqrt(solved.fun @ solved.fun / max(float(np.sum(moved**2)), 1e-300)))
    return Mount(float(solved.x[0]) * unit, float(solved.x[1]), float(spread) * unit, share, float(solved.x[3]))


def _holding(model: ModalModel, pose: np.ndarray, effort_gain: np.ndarray) -> np.ndarray:
    """Return the torque (or force) (n_axes,) that holds the axes against gravity: B_r u = -d_r."""
    n, rest = len(model.axes), model.at(pose)[model.modes * model.mode_stride :]
    shift: np.ndarray = -np.linalg.solve(rest[: n * n].reshape(n, n), rest[n * (n + 1) :][:n]) * effort_gain
    return shift


def detector_places(model: ModalModel, poses: np.ndarray, frame: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the detector's centre from a point of the first axis (poses, 3) and its rotation (poses, 3, 3).

    Both are in the frame's directions.
    """
    chain = model.chain
    places, turns = np.zeros((len(poses), 3)), np.zeros((len(poses), 3, 3))
    for i, pose in enumerate(poses):
        turn, place = np.eye(3), -chain.points[0]
        for k, angle in enumerate(pose):
            place = place + turn @ chain.points[k]
            if chain.revolute[k]:
                turn = turn @ Rotation.from_rotvec(chain.axes[k] * angle).as_matrix()
            else:
                place = place + turn @ chain.axes[k] * angle
        places[i], turns[i] = frame @ (place + turn @ model.sensors[0].body_end_m), frame @ turn
    return places, turns
