"""Identification of kinematic parameters from measured poses (thesis Sec. 2.3.4), with what the poses cannot see reported by name."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from controllers.models.denavit_hartenberg import DenavitHartenberg
from hil.calibration.kinematic.observable import NullCombination, fit_seen
from hil.errors import UnusableInputError

PARALLEL = 0.05
"""Consecutive moving axes with |sin(alpha)| below this need Hayati's parameter, which the chain does not have."""


MOVES_RAD = 0.02
"""A joint whose angles spread by less was only shaken by the others' drives; its ratio is not fitted to that."""


@dataclass(frozen=True)
class PoseNoise:
    """Standard deviation of measured poses."""

    position_m: float
    angle_rad: float


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
        """Root mean square of the position residual [m]."""
        return float(np.sqrt(np.mean(np.sum(self.residual[:, :3] ** 2, axis=1))))


def pose_difference(position: np.ndarray, rotation: np.ndarray, model_position: np.ndarray, model_rotation: np.ndarray) -> np.ndarray:
    """Return measured less model (N, 6): position [m] and rotation vector [rad], both in detector coordinates."""
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
    UnusableInputError
        Fewer equations than parameters, an unknown name in `frozen`, or parallel moving axes.
    BadAnswerError
        The iteration does not converge.
    """
    angles = np.atleast_2d(np.asarray(angles, dtype=float))
    if angles.shape[1] != len(start.joints):
        raise UnusableInputError(f"{angles.shape[1]} angles a pose; the chain has {len(start.joints)} joints: {', '.join(start.joints)}")
    free = free_parameters(start, start.names, angles, frozen)
    if 6 * len(angles) < free.size:
        raise UnusableInputError(f"{len(angles)} poses give {6 * len(angles)} equations for {free.size} parameters; measure more poses")
    weight = 1.0 / np.repeat([noise.position_m, noise.angle_rad], 3)
    origin = start.values

    def residual_of(values: np.ndarray) -> np.ndarray:
        return (pose_difference(position, rotation, *start.with_values(values).poses(angles)) * weight).ravel()

    def jacobian_of(values: np.ndarray) -> np.ndarray:
        return (start.with_values(values).jacobian(angles) * weight[:, None]).reshape(-1, origin.size)

    fit = fit_seen(residual_of, jacobian_of, origin, free, start.names)
    return Identified(
        model=start.with_values(fit.values),
        covariance=fit.covariance,
        rank=fit.rank,
        singular_values=fit.singular_values,
        null=fit.null,
        frozen=tuple(name for k, name in enumerate(start.names) if k not in set(free)),
        residual=fit.residual.reshape(-1, 6) / weight,
    )


def free_parameters(chain: DenavitHartenberg, names: Sequence[str], angles: np.ndarray, frozen: Collection[str]) -> np.ndarray:
    """Return the numbers of the parameters to fit.

    These are all but the requested frozen ones and the gear ratio of joints that do not move.

    Parameters
    ----------
    chain : DenavitHartenberg
    names : sequence of str
        All parameters, those of the chain first.
    angles : (N, n) array
        Of the chain's joints [rad].
    frozen : collection of str

    Raises
    ------
    UnusableInputError
        An unknown name, or parallel moving axes.
    """
    unknown = sorted(set(frozen) - set(names))
    if unknown:
        raise UnusableInputError(f"unknown parameters {', '.join(unknown)}; the model has {', '.join(names)}")
    moves = np.ptp(angles, axis=0) > MOVES_RAD
    moving = np.flatnonzero(moves)
    for first, second in pairwise(moving):
        if second == first + 1 and abs(np.sin(chain.table[first, 2])) < PARALLEL:
            raise UnusableInputError(
                f"axes {chain.joints[first]} and {chain.joints[second]} are parallel (alpha {chain.table[first, 2]:.4g} rad);"
                " Denavit-Hartenberg parameters cannot say where the one is from the other"
            )
    still = {f"beta_{joint}" for joint, moved in zip(chain.joints, moves, strict=True) if not moved}
    return np.array([k for k, name in enumerate(names) if name not in frozen and name not in still])
