"""Denavit-Hartenberg kinematics from the detector to the phantom (thesis Sec. 2.3.1), with every derivative.

    T(q) = Rx(theta_u) Ry(theta_v) . 1T 2T ... nT . Ry(theta_y) Rz(theta_z)                      (2.9), (2.12)
    jT   = Rz(theta_j) Tz(d_j) Tx(a_j) Rx(alpha_j),  theta_j = delta_theta_j + beta_j q_j        (2.7), (2.8)

T takes phantom coordinates to detector coordinates; (2.7)'s third row is [0, sin(alpha), cos(alpha), d] (correction), which the product of
the four elementary motions gives by itself. The chain starts at the detector, so its last column is nu_ph^d of (2.2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.models.motions import Motion, X, Y, Z, frames_of, motion_jacobian

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

    Examples
    --------
    Two links of 1 m: stretched, then with the first joint turned by a right angle.

    >>> import numpy as np
    >>> from controllers.models.denavit_hartenberg import DenavitHartenberg
    >>> chain = DenavitHartenberg(("inner", "outer"), np.array([[1.0, 0.0, 0.0, 0.0, 1.0]] * 2), np.zeros(4))
    >>> position, rotation = chain.poses(np.array([[0.0, 0.0], [np.pi / 2.0, 0.0]]))
    >>> np.abs(position).round(6).tolist()
    [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]
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
        """All parameters (5 n + 4,)."""
        return np.concatenate([self.table.ravel(), self.frame_angles])

    def with_values(self, values: np.ndarray) -> DenavitHartenberg:
        """Return the same chain with other parameters."""
        count = self.table.size
        return replace(self, table=np.reshape(values[:count], self.table.shape).copy(), frame_angles=np.array(values[count:]))

    def poses(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the pose of the phantom, seen from the detector.

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
        angles = self.checked(angles)
        end = frames_of([motion for row in self.motions(angles) for motion in row], len(angles))[-1]
        return end[:, :3, 3], end[:, :3, :3]

    def jacobian(self, angles: np.ndarray) -> np.ndarray:
        """Return the change (N, 6, 5 n + 4) of nu_ph^d [m], then of the rotation [rad, detector coordinates], per unit parameter (2.17)."""
        angles = self.checked(angles)
        motions = [motion for row in self.motions(angles) for motion in row]
        frames = frames_of(motions, len(angles))
        return motion_jacobian(motions, frames, frames[-1][:, :3, 3], len(self.names))

    def motions(self, angles: np.ndarray) -> list[list[Motion]]:
        """Return the elementary motions in order, for N poses: the panel's two turns, one list a joint, the phantom's two turns."""
        last = self.table.size
        theta_u, theta_v, theta_y, theta_z = self.frame_angles
        ones = np.ones(len(angles))
        result = [[Motion(True, X, theta_u * ones, ((last, 1.0),)), Motion(True, Y, theta_v * ones, ((last + 1, 1.0),))]]
        for j, (a, delta_theta, alpha, d, beta) in enumerate(self.table):
            q, first = angles[:, j], 5 * j
            result.append(
                [
                    Motion(True, Z, delta_theta + beta * q, ((first + 1, 1.0), (first + 4, q))),
                    Motion(False, Z, d * ones, ((first + 3, 1.0),)),
                    Motion(False, X, a * ones, ((first, 1.0),)),
                    Motion(True, X, alpha * ones, ((first + 2, 1.0),)),
                ]
            )
        result.append([Motion(True, Y, theta_y * ones, ((last + 2, 1.0),)), Motion(True, Z, theta_z * ones, ((last + 3, 1.0),))])
        return result

    def checked(self, angles: np.ndarray) -> np.ndarray:
        """Return angles as an array (N, n).

        Raises
        ------
        ValueError
            The number of angles is not the number of joints.
        """
        angles = np.atleast_2d(np.asarray(angles, dtype=float))
        if angles.shape[1] != len(self.joints):
            raise ValueError(f"{angles.shape[1]} angles a pose; the chain has {len(self.joints)} joints: {', '.join(self.joints)}")
        return angles
