"""Denavit-Hartenberg kinematics from the detector to the phantom (thesis Sec. 2.3.1), with every derivative.

    T(q) = Rx(theta_u) Ry(theta_v) . 1T 2T ... nT . Ry(theta_y) Rz(theta_z)                      (2.9), (2.12)
    jT   = Rz(theta_j) Tz(d_j) Tx(a_j) Rx(alpha_j),  theta_j = delta_theta_j + beta_j q_j        (2.7), (2.8)

T takes phantom coordinates to detector coordinates; (2.7)'s third row is [0, sin(alpha), cos(alpha), d] (correction), which the product of
the four elementary motions gives by itself. The chain starts at the detector, so its last column is nu_ph^d of (2.2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

X, Y, Z = 0, 1, 2
ROTATION, TRANSLATION = "rotation", "translation"

DH_COLUMNS = ("a", "delta_theta", "alpha", "d", "beta")
FRAME_ANGLES = ("theta_u", "theta_v", "theta_y", "theta_z")


@dataclass(frozen=True)
class DenavitHartenberg:
    """A serial chain of revolute joints, seen from the detector.

    Attributes
    ----------
    joints : tuple of str
        Names, detector first.
    table : (n, 5) array
        a [m], delta_theta [rad], alpha [rad], d [m], beta [-] a joint.
    frame_angles : (4,) array
        theta_u, theta_v of the panel, theta_y, theta_z of the phantom [rad] (2.12).
    """

    joints: tuple[str, ...]
    table: np.ndarray
    frame_angles: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of `values`."""
        return (*(f"{column}_{joint}" for joint in self.joints for column in DH_COLUMNS), *FRAME_ANGLES)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return (*(("m", "rad", "rad", "m", "-") * len(self.joints)), "rad", "rad", "rad", "rad")

    @property
    def values(self) -> np.ndarray:
        """(5 n + 4,) all parameters."""
        return np.concatenate([self.table.ravel(), self.frame_angles])

    def with_values(self, values: np.ndarray) -> DenavitHartenberg:
        """The same chain with other parameters."""
        count = self.table.size
        return replace(self, table=np.reshape(values[:count], self.table.shape).copy(), frame_angles=np.array(values[count:]))

    def poses(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where the phantom is, seen from the detector.

        Parameters
        ----------
        angles : (N, n) array
            Joint angles q [rad].

        Returns
        -------
        position : (N, 3) array
            nu_ph^d [m].
        rotation : (N, 3, 3) array
            From phantom to detector coordinates.
        """
        frames = self._frames(angles)[-1]
        return frames[:, :3, 3], frames[:, :3, :3]

    def jacobian(self, angles: np.ndarray) -> np.ndarray:
        """(N, 6, 5 n + 4) change of nu_ph^d [m], then of the rotation [rad, in detector coordinates], per unit of each parameter (2.17)."""
        angles = np.atleast_2d(angles)
        frames = self._frames(angles)
        end = frames[-1][:, :3, 3]
        result = np.zeros((len(angles), 6, len(self.names)))
        for before, (kind, axis, _, parameters) in zip(frames[:-1], self._motions(angles), strict=True):
            direction = before[:, :3, axis]
            if kind == ROTATION:
                motion = np.concatenate([np.cross(direction, end - before[:, :3, 3]), direction], axis=1)
            else:
                motion = np.concatenate([direction, np.zeros_like(direction)], axis=1)
            for column, gain in parameters:
                result[:, :, column] += motion * np.broadcast_to(gain, len(angles))[:, None]
        return result

    def _motions(self, angles: np.ndarray) -> list[tuple[str, int, np.ndarray, tuple[tuple[int, np.ndarray | float], ...]]]:
        """Elementary motions in order: kind, axis, amount (N,), and (parameter's column, d amount / d parameter)."""
        last = self.table.size
        theta_u, theta_v, theta_y, theta_z = self.frame_angles
        ones = np.ones(len(angles))
        motions: list[tuple[str, int, np.ndarray, tuple[tuple[int, np.ndarray | float], ...]]] = [
            (ROTATION, X, theta_u * ones, ((last, 1.0),)),
            (ROTATION, Y, theta_v * ones, ((last + 1, 1.0),)),
        ]
        for j, (a, delta_theta, alpha, d, beta) in enumerate(self.table):
            q, first = angles[:, j], 5 * j
            motions += [
                (ROTATION, Z, delta_theta + beta * q, ((first + 1, 1.0), (first + 4, q))),
                (TRANSLATION, Z, d * ones, ((first + 3, 1.0),)),
                (TRANSLATION, X, a * ones, ((first, 1.0),)),
                (ROTATION, X, alpha * ones, ((first + 2, 1.0),)),
            ]
        return [*motions, (ROTATION, Y, theta_y * ones, ((last + 2, 1.0),)), (ROTATION, Z, theta_z * ones, ((last + 3, 1.0),))]

    def _frames(self, angles: np.ndarray) -> list[np.ndarray]:
        """(N, 4, 4) frame before each elementary motion and after the last."""
        angles = np.atleast_2d(np.asarray(angles, dtype=float))
        if angles.shape[1] != len(self.joints):
            raise ValueError(f"{angles.shape[1]} angles a pose; the chain has {len(self.joints)} joints: {', '.join(self.joints)}")
        frames = [np.broadcast_to(np.eye(4), (len(angles), 4, 4))]
        for kind, axis, amount, _ in self._motions(angles):
            frames.append(frames[-1] @ _elementary(kind, axis, amount))
        return frames


def _elementary(kind: str, axis: int, amount: np.ndarray) -> np.ndarray:
    """(N, 4, 4) rotation about, or translation along, one coordinate axis."""
    result = np.tile(np.eye(4), (len(amount), 1, 1))
    if kind == TRANSLATION:
        result[:, axis, 3] = amount
        return result
    second, third = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine = np.cos(amount), np.sin(amount)
    result[:, second, second] = result[:, third, third] = cosine
    result[:, third, second], result[:, second, third] = sine, -sine
    return result
