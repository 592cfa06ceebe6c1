"""Identification of kinematic parameters from measured poses (thesis Sec. 2.3.4), with what the poses cannot see reported by name."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from controllers.models.kinematics import DenavitHartenberg
from hil.errors import BadAnswer, UnusableInput

VISIBLE = 1e-6
"""Singular values of the scaled Jacobian below this share of the largest are null: rounding leaves 1e-16, the weakest seen combination of
Table 2.2's chain 1e-4 or more."""

PARALLEL = 0.05
"""Consecutive moving axes with |sin(alpha)| below this need Hayati's parameter, which the chain does not have."""

FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e12
CONVERGED = 1e-10
"""Relative fall of the weighted sum of squares at which the iteration ends."""
MOST_STEPS = 60


@dataclass(frozen=True)
class PoseNoise:
    """Standard deviation of measured poses."""

    position_m: float
    angle_rad: float


@dataclass(frozen=True)
class NullCombination:
    """A direction in parameter space the poses do not see: parameters by name and their shares, largest first."""

    shares: tuple[tuple[str, float], ...]
    singular_value: float  # relative to the largest

    def __str__(self) -> str:
        return " ".join(f"{share:+.2f} {name}" for name, share in self.shares if abs(share) > 0.05)


@dataclass(frozen=True)
class Identified:
    """A chain fitted to poses.

    Attributes
    ----------
    model : DenavitHartenberg
    covariance : (p, p) array
        (J' C^-1 J)^+ over all parameters (correction to (2.21)); zero for what was frozen.
    rank : int
        Combinations of the free parameters that the poses see.
    singular_values : array
        Of the scaled Jacobian, relative to the largest.
    null : tuple of NullCombination
        Left at their start.
    frozen : tuple of str
        Parameters kept by request or because their joint does not move.
    residual : (N, 6) array
        Measured less model: position [m] and rotation [rad] in detector coordinates.
    """

    model: DenavitHartenberg
    covariance: np.ndarray
    rank: int
    singular_values: np.ndarray
    null: tuple[NullCombination, ...]
    frozen: tuple[str, ...]
    residual: np.ndarray

    @property
    def position_rms_m(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self.residual[:, :3] ** 2, axis=1))))

    @property
    def angle_rms_rad(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self.residual[:, 3:] ** 2, axis=1))))


def pose_difference(position: np.ndarray, rotation: np.ndarray, model_position: np.ndarray, model_rotation: np.ndarray) -> np.ndarray:
    """(N, 6) measured less model: position [m] and rotation vector [rad], both in detector coordinates."""
    turned = Rotation.from_matrix(rotation @ np.swapaxes(model_rotation, 1, 2)).as_rotvec()
    return np.concatenate([position - model_position, turned], axis=1)


def identify_kinematics(
    start: DenavitHartenberg,
    angles: np.ndarray,
    position: np.ndarray,
    rotation: np.ndarray,
    noise: PoseNoise,
    frozen: Collection[str] = (),
) -> Identified:
    """Fit a chain to measured poses by Levenberg-Marquardt on the combinations that the poses see.

    Parameters
    ----------
    start : DenavitHartenberg
        Nominal parameters; what the poses do not see stays here.
    angles : (N, n) array
        Joint angles [rad].
    position, rotation : (N, 3), (N, 3, 3) arrays
        Measured nu_ph^d [m] and rotation from phantom to detector coordinates.
    noise : PoseNoise
    frozen : collection of str
        Parameters not to fit.

    Raises
    ------
    UnusableInput
        Fewer equations than parameters, an unknown name in `frozen`, or parallel moving axes.
    BadAnswer
        The iteration does not converge.
    """
    angles = np.atleast_2d(np.asarray(angles, dtype=float))
    if angles.shape[1] != len(start.joints):
        raise UnusableInput(f"{angles.shape[1]} angles a pose; the chain has {len(start.joints)} joints: {', '.join(start.joints)}")
    free = _free(start, angles, frozen)
    if 6 * len(angles) < free.size:
        raise UnusableInput(f"{len(angles)} poses give {6 * len(angles)} equations for {free.size} parameters; measure more poses")
    weight = 1.0 / np.repeat([noise.position_m, noise.angle_rad], 3)
    origin = start.values

    def evaluate(values: np.ndarray) -> tuple[DenavitHartenberg, np.ndarray, float]:
        model = start.with_values(values)
        residual = pose_difference(position, rotation, *model.poses(angles)) * weight
        return model, residual.ravel(), float(np.sum(residual**2))

    def whitened(model: DenavitHartenberg) -> np.ndarray:
        return (model.jacobian(angles) * weight[:, None])[:, :, free].reshape(-1, free.size)

    values, damping = origin.copy(), FIRST_DAMPING
    model, residual, cost = evaluate(values)
    for _ in range(MOST_STEPS):
        seen = _seen(whitened(model))
        slope = seen.u.T @ residual
        while True:
            change = seen.to_parameters @ (slope * seen.s / (seen.s**2 + damping * seen.s[0] ** 2))
            trial = values.copy()
            trial[free] += change
            trial_model, trial_residual, trial_cost = evaluate(trial)
            if trial_cost <= cost or damping > LARGEST_DAMPING:
                break
            damping = max(10.0 * damping, FIRST_DAMPING)
        fall = cost - trial_cost
        if fall < 0.0:
            break
        values, model, residual, cost = trial, trial_model, trial_residual, trial_cost
        damping *= 0.01
        if fall <= CONVERGED * cost:
            break
    else:
        raise BadAnswer(f"no convergence in {MOST_STEPS} steps; the start is too far off, or the angles are of other exposures")
    seen = _seen(whitened(model))
    covariance = np.zeros((len(origin), len(origin)))
    half = seen.to_parameters / seen.s
    covariance[np.ix_(free, free)] = half @ half.T
    names = np.array(start.names)
    return Identified(
        model=model,
        covariance=covariance,
        rank=len(seen.s),
        singular_values=seen.all_values / seen.all_values[0],
        null=tuple(
            NullCombination(_shares(names[free], row), float(value / seen.all_values[0]))
            for row, value in zip(seen.null, seen.all_values[len(seen.s) :], strict=True)
        ),
        frozen=tuple(str(name) for k, name in enumerate(names) if k not in set(free)),
        residual=residual.reshape(-1, 6) / weight,
    )


@dataclass(frozen=True)
class _Seen:
    """What the poses see of the free parameters."""

    u: np.ndarray  # (M, r)
    s: np.ndarray  # (r,) of the scaled Jacobian
    to_parameters: np.ndarray  # (p, r) from seen combinations to parameters
    null: np.ndarray  # (p - r, p) in scaled parameters
    all_values: np.ndarray


def _seen(jacobian: np.ndarray) -> _Seen:
    """Singular value decomposition with columns scaled to unit length, cut where `VISIBLE` says."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale[scale == 0.0] = 1.0
    u, s, vt = np.linalg.svd(jacobian / scale, full_matrices=False)
    rank = int(np.sum(s > VISIBLE * s[0]))
    return _Seen(u[:, :rank], s[:rank], vt[:rank].T / scale[:, None], vt[rank:], s)


def _free(start: DenavitHartenberg, angles: np.ndarray, frozen: Collection[str]) -> np.ndarray:
    """Columns to fit: everything but what was asked to be kept and the ratio of joints that do not move."""
    unknown = sorted(set(frozen) - set(start.names))
    if unknown:
        raise UnusableInput(f"unknown parameters {', '.join(unknown)}; the chain has {', '.join(start.names)}")
    moves = np.ptp(angles, axis=0) > 0.0
    moving = np.flatnonzero(moves)
    for first, second in pairwise(moving):
        if second == first + 1 and abs(np.sin(start.table[first, 2])) < PARALLEL:
            raise UnusableInput(
                f"axes {start.joints[first]} and {start.joints[second]} are parallel (alpha {start.table[first, 2]:.4g} rad);"
                " Denavit-Hartenberg parameters cannot say where the one is from the other"
            )
    still = {f"beta_{joint}" for joint, moved in zip(start.joints, moves, strict=True) if not moved}
    return np.array([k for k, name in enumerate(start.names) if name not in frozen and name not in still])


def _shares(names: np.ndarray, row: np.ndarray) -> tuple[tuple[str, float], ...]:
    order = np.argsort(-np.abs(row))
    return tuple((str(names[k]), float(row[k])) for k in order)
