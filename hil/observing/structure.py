"""Springs and inertias between drives and detector, from the modes of all poses together.

A mode moves the gears, the detector against the link side, and the mount. In these coordinates the springs are a diagonal matrix that is
the same in every pose, and modes are orthogonal in it:

    φ_iᵀ K φ_j = δ_ij m_i ω_i²,    m_i from how a drive pushes a mode that moves it (`directions`)

K, and the height of the mount's axis, are fitted to that at all poses at once; the resulting m_i is also the modal mass of modes that
hardly move a drive. The axes' momenta N = Eᵀ M follow from Eᵀ M E = T B_r⁻¹ and Eᵀ M φ = 0, E the axes' rigid motion, and from their slopes
over the pose follows what turning couples (`with_coupling`): M depends on the link sides alone, for the mount turns all of it, and the
effect of the detector's own turns on it is neglected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from controllers.models.modal import ModalModel, basis_at, basis_size
from hil.errors import BadAnswerError
from hil.observing.directions import Shapes, drives_masses, shapes_at, soft_directions
from hil.observing.modal_fit import TURN_LENGTH_m
from hil.observing.over_poses import embedded, harmonics_for
from hil.observing.sag import Mount, detector_places, first_axis_frame

INERTIA_HARMONIC = 2
"""Of the pose, in inertias: squares of sines."""

TRUSTED = 0.02
"""Share of a mode's strain energy beyond which a pose's misfit counts only in proportion: weak modes are poorly known at some poses."""

LARGEST_MISFIT = 0.05
"""Median misfit of the energies over which there is no such structure."""

STEP_rad = 1e-4
"""Difference step of trigonometric polynomials of low order."""


@dataclass(frozen=True)
class Structure:
    """Springs between drives and detector, and what the modes do in them.

    Attributes
    ----------
    poses : (P, n_axes)
    seen : (P,) the modes' shapes there.
    mount : with its axes' places and compliance.
    turns : (k, 3) about which the detector yields against the link side, in its frame.
    springs, deviations : (n_axes + k + 2,) of gears [Nm/rad], turns, and the mount about the first axis and about the vertical.
    lever_deviation : of the height of the mount's axis [m].
    moves : (P, modes, n_axes + k + 2) by the modes.
    inverse_masses : (P, modes)
    misfit : median of the energies'.
    """

    poses: np.ndarray
    seen: tuple[Shapes, ...]
    mount: Mount
    turns: np.ndarray
    springs: np.ndarray
    deviations: np.ndarray
    lever_deviation: float
    moves: np.ndarray
    inverse_masses: np.ndarray
    misfit: float

    @property
    def note(self) -> str:
        """Return one line for a design."""
        values = ", ".join(f"{value:.5g} ± {spread:.1g}" for value, spread in zip(self.springs, self.deviations, strict=True))
        return (
            f"springs of gears, detector and mount: {values} Nm/rad; the mount turns {self.mount.lever:.2f} ± {self.lever_deviation:.1g} m"
            f" above the first axis; energies are met to {100.0 * self.misfit:.1f} %"
        )


def found_structure(model: ModalModel, poses: Sequence[np.ndarray], effort_gain: np.ndarray, mount: Mount | None) -> Structure | None:
    """Fit the springs, starting from a mount found from slow motions (`sag`).

    None where modes or poses do not determine them, or the inertias.

    Parameters
    ----------
    model : ModalModel
    poses : sequence of (n_axes,) arrays
        At which it was identified.
    effort_gain : (n_axes,) array
        Force or torque on the joint per unit of the drive.
    mount : Mount, optional
    """
    frame = first_axis_frame(model.chain)
    if mount is None or not mount.is_clear or frame is None:
        return None
    at = np.asarray(poses, float)
    if min(harmonics_for(at)[1:], default=INERTIA_HARMONIC) < INERTIA_HARMONIC:
        return None
    seen = tuple(shapes_at(model, pose) for pose in at)
    masses = drives_masses(seen, effort_gain)
    turns, _ = soft_directions(seen, masses)
    if not len(model.axes) + len(turns) < model.modes < len(model.axes) + len(turns) + 3:
        return None
    stiffness = np.array([here.stiffness for here in seen])
    places = detector_places(model, at, frame)
    size = np.sqrt(np.abs(masses) / stiffness)[:, :, None]
    pairs = [(i, j) for i in range(model.modes) for j in range(i + 1)]
    wanted = np.repeat([float(i == j) for i, j in pairs], len(at))

    def shares(lever: float) -> np.ndarray:
        moves = size * _moves(seen, places, turns, lever, mount.vertical)
        return np.concatenate([moves[:, i] * moves[:, j] for i, j in pairs])

    start = shares(mount.lever)
    scale = np.sqrt(np.mean(start**2, axis=0)) + 1e-300
    springs = np.linalg.lstsq(start / scale, wanted, rcond=1e-9)[0] / scale
    unit = np.where(springs > 0.0, springs, 1.0 / scale)
    solved = optimize.least_squares(
        lambda x: shares(x[0]) @ (x[1:] * unit) - wanted, np.concatenate(([mount.lever], springs / unit)),
        loss="soft_l1", f_scale=TRUSTED, x_scale="jac",
    )  # fmt: skip
    lever, springs = float(solved.x[0]), solved.x[1:] * unit
    spread = _spread(solved, len(at)) * np.concatenate(([1.0], unit))
    misfit = float(np.median(np.abs(solved.fun)))
    if misfit > LARGEST_MISFIT or not (springs > 0.0).all():
        return None
    moves = _moves(seen, places, turns, lever, mount.vertical)
    energy = np.einsum("pmc,c->pm", moves**2, springs)
    found = replace(mount, compliance=float(1.0 / springs[-2]), lever=lever)
    return Structure(at, seen, found, turns, springs, spread[1:], float(spread[0]), moves, stiffness / energy, misfit)


def _spread(solved: optimize.OptimizeResult, poses: int) -> np.ndarray:
    """Return deviations of the result of a soft-L1 fit, from how the residual pulls at it pose by pose.

    Within a pose the residual is not independent: H⁻¹ (Σ_p s_p s_pᵀ) H⁻¹ with s_p the gradient of a pose's cost (Huber 1967; clusters:
    Liang, Zeger 1986), H by Gauss and Newton. SciPy returns the Jacobian scaled by (1 + z)^-3/4, z = (r / scale)²: with r (1 + z)^1/4 it
    gives the gradient.
    """
    pulled = solved.jac * (solved.fun * (1.0 + (solved.fun / TRUSTED) ** 2) ** 0.25)[:, None]
    by_pose = pulled.reshape(-1, poses, len(solved.x)).sum(axis=0)
    inverse = np.linalg.pinv(solved.jac.T @ solved.jac)
    free = poses / max(poses - len(solved.x), 1)
    deviation: np.ndarray = np.sqrt(free * np.sum((by_pose @ inverse) ** 2, axis=0))
    return deviation


def with_places(model: ModalModel, structure: Structure) -> ModalModel:
    """Return the model whose disturbances act at the drives, in the gears, between link side and detector, and at the mount."""
    n, rows = len(model.axes), []
    for here, moves, inverse in zip(structure.seen, structure.moves, structure.inverse_masses, strict=True):
        drives = np.vstack((here.rigid, here.inputs / here.stiffness[:, None]))
        pushed = (inverse / here.stiffness)[:, None] * moves
        rows.append(np.hstack((drives, np.vstack((np.zeros((n, moves.shape[1])), pushed)))))
    table = np.array(rows)
    directions = spread_over_poses(table, structure.poses, model.harmonics).reshape(*table.shape[1:], -1)
    return replace(model, directions=directions, places=("drive",) * n + ("gear",) * n + ("turn",) * len(structure.turns) + ("mount",) * 2)


def with_inertia(model: ModalModel, poses: Sequence[np.ndarray], effort_gain: np.ndarray) -> ModalModel:
    """Return the model with symmetric inertias of the axes, B_r = M_r⁻¹ T, that do not change with the first axis.

    The first axis turns all of it. Inertias from the responses are slightly wrong, for gravity acts as a spring there that changes its sign
    with the pose.

    Raises
    ------
    BadAnswerError
        At a pose the responses make an inertia that is not positive definite: a command that moves nothing, or the wrong way.
    """
    n, first = len(model.axes), model.modes * model.mode_stride
    at = np.asarray(poses, float)
    mobility = np.array([model.at(pose)[first : first + n * n].reshape(n, n) / effort_gain for pose in at])
    for pose, given in zip(at, mobility, strict=True):
        least, directions = np.linalg.eigh(given + given.T)
        if least[0] <= 0.0:
            axis = model.axes[int(np.argmax(np.abs(directions[:, 0])))]
            raise BadAnswerError(
                f"at {np.round(pose, 3).tolist()} (rad or m) the command does not move {axis} as a mass would be moved: check that it was"
                " excited, and the signs of its constant, ratio and encoders"
            )
    inertia = np.linalg.inv(mobility)
    smooth = _Inertia(0.5 * (inertia + inertia.transpose(0, 2, 1)), at)
    rigid = np.array([np.linalg.solve(smooth.at(pose), np.diag(effort_gain)) for pose in at])
    coefficients = model.coefficients.copy()
    coefficients[first : first + n * n] = spread_over_poses(rigid, at, model.harmonics)
    return replace(model, coefficients=coefficients)


class _Inertia:
    """A matrix that varies with all axes but the first, as inertias do."""

    def __init__(self, values: np.ndarray, poses: np.ndarray, with_first: bool = False) -> None:
        told = harmonics_for(poses)
        self.harmonics = tuple(min(order, INERTIA_HARMONIC) if k or with_first else 0 for k, order in enumerate(told))
        self.shape, self.axes = values.shape[1:], poses.shape[1]
        self.table = np.linalg.lstsq(basis_at(self.harmonics, poses), values.reshape(len(poses), -1), rcond=1e-8)[0]

    def at(self, pose: np.ndarray) -> np.ndarray:
        values_there: np.ndarray = (basis_at(self.harmonics, pose[None])[0] @ self.table).reshape(self.shape)
        return values_there

    def slopes(self, pose: np.ndarray) -> np.ndarray:
        """Return slopes (n_axes, ...) over the axes' positions."""
        steps = STEP_rad * np.eye(self.axes)
        return np.array([(self.at(pose + step) - self.at(pose - step)) / (2.0 * STEP_rad) for step in steps])


def with_coupling(model: ModalModel, structure: Structure, effort_gain: np.ndarray) -> ModalModel:
    """Return the model with the joint push of axes' and modes' speeds on the axes, and the effect of products of axes' speeds.

    H_k(a, b) = ∂_a N_b φ_k + ∂_b N_a φ_k - Σ_c l_ck ∂_c M_ab, l_ck the mode's motion of link side c: a' η_k' pushes axis b with it, by
    Christoffel's symbols and Eᵀ M ∂φ = -Eᵀ ∂M φ, which follows from Eᵀ M φ = 0 for a shape that changes with the pose.
    """
    n, modes, poses = len(model.axes), model.modes, structure.poses
    first = modes * model.mode_stride
    inertia = _Inertia(
        np.array([np.linalg.solve(model.at(pose)[first : first + n * n].reshape(n, n).T, np.diag(effort_gain)).T for pose in poses]), poses
    )
    shapes = []
    for here, moves in zip(structure.seen, structure.moves, strict=True):
        rigid = np.vstack((np.eye(n), np.zeros((modes, n))))
        shapes.append(np.hstack((rigid, np.vstack((here.motor.T, moves[:, :modes].T)))))
    momenta = np.array([
        np.linalg.solve(shape.T, np.vstack((inertia.at(pose), np.zeros((modes, n))))).T
        for shape, pose in zip(shapes, poses, strict=True)
    ])  # fmt: skip
    yields = n + n + len(structure.turns)  # motor sides, gears and turns; behind them the mount, which the first axis turns against
    of_arc, of_mount = _Inertia(momenta[:, :, :yields], poses), _Inertia(momenta[:, :, yields:], poses, with_first=True)
    pairs = [(j, k) for j in range(n) for k in range(j, n)]
    coupling, turning = np.zeros((len(poses), n, n, modes)), np.zeros((len(poses), n, len(pairs)))
    for p, pose in enumerate(poses):
        slopes, inverse = inertia.slopes(pose), np.linalg.inv(inertia.at(pose))
        by_shape = np.concatenate((of_arc.slopes(pose), of_mount.slopes(pose)), axis=2) @ shapes[p][:, n:]  # (a, b, mode)
        pushed = by_shape + by_shape.transpose(1, 0, 2) - np.einsum("kc,cab->abk", structure.seen[p].link, slopes)
        coupling[p] = np.einsum("bc,ack->abk", inverse, pushed)
        for place, (j, k) in enumerate(pairs):
            torque = slopes[j][:, k] + slopes[k][:, j] - slopes[:, j, k]
            turning[p, :, place] = -inverse @ torque * (0.5 if j == k else 1.0)
    of_modes = np.zeros((modes, len(pairs), basis_size(model.harmonics))) if model.turning is None else model.turning[n:]
    of_axes = spread_over_poses(turning, poses, model.harmonics).reshape(n, len(pairs), -1)
    return replace(
        model,
        turning=np.ascontiguousarray(np.concatenate((of_axes, of_modes))),
        coupling=spread_over_poses(coupling, poses, model.harmonics).reshape(n, n, modes, -1),
    )


def _moves(seen: Sequence[Shapes], places: tuple[np.ndarray, np.ndarray], turns: np.ndarray, lever: float, vertical: float) -> np.ndarray:
    """Return what modes turn in gears, between link side and detector, and of the mount about its two axes.

    Shape (P, modes, n_axes + k + 2), by least squares of the detector's shift and turn against the link side: the mount turns and shifts
    it, the rest turns it.
    """
    moves = []
    for here, place, rotation in zip(seen, *places, strict=True):
        by = relative_motion(place, rotation, turns, lever, vertical)
        twist = np.vstack((rotation @ here.relative[:, :3].T, TURN_LENGTH_m * rotation @ here.relative[:, 3:].T))
        moves.append(np.hstack((here.link - here.motor, np.linalg.lstsq(by, twist, rcond=1e-6)[0].T)))
    return np.array(moves)


def relative_motion(place: np.ndarray, rotation: np.ndarray, turns: np.ndarray, lever: float, vertical: float) -> np.ndarray:
    """Return shift of the detector against the link side, and turn times `TURN_LENGTH_m`: (6, k + 2).

    They are caused by its own turns and the mount's two, in the frame's directions.
    """
    by = np.zeros((6, len(turns) + 2))
    by[:3, -2], by[:3, -1] = (0.0, lever - place[2], place[1]), (-place[1], place[0] - vertical, 0.0)
    by[3:, :-2] = TURN_LENGTH_m * rotation @ turns.T
    by[3:, -2:] = TURN_LENGTH_m * np.eye(3)[:, [0, 2]]
    return by


def spread_over_poses(table: np.ndarray, poses: np.ndarray, harmonics: tuple[int, ...]) -> np.ndarray:
    """Return coefficients (rows, basis) of what varies over the poses (P, ...), in the model's basis.

    The order is what these poses can determine.
    """
    told = tuple(min(pair) for pair in zip(harmonics_for(poses), harmonics, strict=True))
    found = np.linalg.lstsq(basis_at(told, poses), table.reshape(len(poses), -1), rcond=1e-8)[0].T
    return np.ascontiguousarray(embedded(found, told, harmonics))
