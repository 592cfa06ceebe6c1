"""Denavit-Hartenberg kinematics with elastic joints under gravity (thesis (2.6), (2.13)-(2.16)), and the focal spot.

Every elastic joint turns (or slides) by its compliance times the effort of gravity on it, (2.15); the efforts are those of the deflected
machine. The turn stands in the chain where the joint is, so its first order (2.13) is not needed. Elastic joints model gears and mounts
(2.16), and the flexible support of Sec. 2.3.3 as joints between the last driven axis and the phantom.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from controllers.models.denavit_hartenberg import DenavitHartenberg
from controllers.models.gravity import GravityTree
from controllers.models.motions import Motion, frames_of, motion_jacobian

SOURCE_NAMES = ("source_u", "source_v", "source_w")

ROUNDS = 8
"""Iterations between deflection and gravity; each shrinks the error by gravity's stiffness over the joint's, a few hundredths at most."""

LEAST_STEP = 1e-12
"""Smallest difference step of a compliance [rad/Nm]: a few hundred Nm bend it by 1e-10 rad."""

IN_CHAIN, AT_PANEL, AT_TUBE = "in_chain", "at_panel", "at_tube"


@dataclass(frozen=True)
class ElasticJoint:
    """A joint without a drive that yields under load.

    Attributes
    ----------
    name : str
    place : str
        `IN_CHAIN`: panel and tube turn together; `AT_PANEL`: between panel and tube, on the panel's side; `AT_TUBE`: on the tube's.
    row : int
        Row of the chain before which it stands: 0 the panel, 1 ... n the joints, n + 1 the phantom.
    axis, point_m : (3,) arrays
        Its line in the frame there, pointing so that a positive turn carries the panel (or the tube) by a positive angle.
    revolute : bool
    coordinate : int
        Its coordinate in the tree.
    """

    name: str
    place: str
    row: int
    axis: np.ndarray
    point_m: np.ndarray
    revolute: bool
    coordinate: int


@dataclass(frozen=True)
class FlexibleChain:
    """Poses of focal spot and phantom, seen from the panel.

    Attributes
    ----------
    chain : DenavitHartenberg
    driven : tuple of int
        The chain's joint that each axis of the machine is, -1 for an axis that moves neither panel nor tube; the other joints stand still.
    source_m : (3,) array
        Focal spot in the detector's frame without gravity.
    elastic : tuple of ElasticJoint
        From the panel to the world.
    compliance : (e,) array
        Compliance of each elastic joint [rad/Nm or m/N].
    tree : GravityTree
        Coordinates: the axes, then the elastic joints.
    """

    chain: DenavitHartenberg
    driven: tuple[int, ...]
    source_m: np.ndarray
    elastic: tuple[ElasticJoint, ...]
    compliance: np.ndarray
    tree: GravityTree

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of `values`."""
        return (*self.chain.names, *SOURCE_NAMES, *(f"compliance_{joint.name}" for joint in self.elastic))

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter."""
        return (*self.chain.units, "m", "m", "m", *("rad/Nm" if joint.revolute else "m/N" for joint in self.elastic))

    @property
    def values(self) -> np.ndarray:
        """All parameters (p,)."""
        return np.concatenate([self.chain.values, self.source_m, self.compliance])

    def with_values(self, values: np.ndarray) -> FlexibleChain:
        """Return the same machine with other parameters."""
        rigid = len(self.chain.names)
        return replace(
            self,
            chain=self.chain.with_values(values[:rigid]),
            source_m=np.array(values[rigid : rigid + 3]),
            compliance=np.array(values[rigid + 3 :]),
        )

    def angles(self, positions: np.ndarray) -> np.ndarray:
        """Return the angles (N, n) of the chain's joints with axes at positions (N, axes); zero for a joint without a drive."""
        angles = np.zeros((len(positions), len(self.chain.joints)))
        for axis, row in enumerate(self.driven):
            if row >= 0:
                angles[:, row] = positions[:, axis]
        return angles

    def deflections(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the deflection (N, e) of the elastic joints [rad or m] with axes at positions (N, axes), and its efforts [Nm or N]."""
        positions = np.atleast_2d(np.asarray(positions, dtype=float))
        bent = np.zeros((len(positions), len(self.elastic)))
        effort = bent
        for _ in range(ROUNDS if self.elastic else 0):
            coordinates = np.zeros((len(positions), positions.shape[1] + len(self.elastic)))
            coordinates[:, : positions.shape[1]] = positions
            for k, joint in enumerate(self.elastic):
                coordinates[:, joint.coordinate] = bent[:, k]
            effort = self.tree.efforts(coordinates)[:, [joint.coordinate for joint in self.elastic]]
            bent = self.compliance * effort
        return bent, effort

    def _gains(self, positions: np.ndarray, bent: np.ndarray) -> np.ndarray:
        """Return the change (N, e, e) of every deflection with each compliance, by differences.

        The change of gravity's effort with the deflection is included.
        """
        result = np.empty((*bent.shape, len(self.elastic)))
        for k, compliance in enumerate(self.compliance):
            step = max(1e-4 * abs(compliance), LEAST_STEP)
            other = self.compliance.copy()
            other[k] += step
            result[:, :, k] = (replace(self, compliance=other).deflections(positions)[0] - bent) / step
        return result

    def poses(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the poses of focal spot and phantom, seen from the panel.

        Parameters
        ----------
        positions : (N, axes) array
            Positions of the machine's axes [rad].

        Returns
        -------
        source, position : (N, 3) arrays
            nu_s^d and nu_ph^d [m].
        rotation : (N, 3, 3) array
            From phantom to detector coordinates.
        """
        chain, tube = self._motions(positions, with_gains=False)
        end = frames_of(chain, len(positions))[-1]
        seen = frames_of(tube, len(positions))[-1]
        return seen[:, :3, :3] @ self.source_m + seen[:, :3, 3], end[:, :3, 3], end[:, :3, :3]

    def jacobian(self, positions: np.ndarray) -> np.ndarray:
        """Return the change (N, 9, p) of source [m], phantom [m] and rotation [rad, detector coordinates] per unit parameter (2.17)."""
        chain, tube = self._motions(positions)
        size, rigid = len(self.names), len(self.chain.names)
        result = np.zeros((len(positions), 9, size))
        frames = frames_of(chain, len(positions))
        result[:, 3:] = motion_jacobian(chain, frames, frames[-1][:, :3, 3], size)
        frames = frames_of(tube, len(positions))
        source = frames[-1][:, :3, :3] @ self.source_m + frames[-1][:, :3, 3]
        result[:, :3] = motion_jacobian(tube, frames, source, size)[:, :3]
        result[:, :3, rigid : rigid + 3] = frames[-1][:, :3, :3]
        return result

    def _motions(self, positions: np.ndarray, with_gains: bool = True) -> tuple[list[Motion], list[Motion]]:
        """Return the motions from the panel to the phantom, and from the panel to the tube."""
        rows = self.chain.motions(self.angles(positions))
        bent, _ = self.deflections(positions)
        gains = self._gains(positions, bent) if with_gains else None
        first = len(self.chain.names) + len(SOURCE_NAMES)
        tube: list[Motion] = []
        for k in range(len(self.elastic) - 1, -1, -1):
            joint = self.elastic[k]
            # A joint that carries the panel by +q makes everything behind it move by -q; the tube itself moves by +q
            sign = 1.0 if joint.place == AT_TUBE else -1.0
            parameters = () if gains is None else tuple((first + j, sign * gains[:, k, j]) for j in range(len(self.elastic)))
            motion = Motion(joint.revolute, joint.axis, sign * bent[:, k], parameters, joint.point_m)
            if joint.place != AT_TUBE:
                rows[joint.row].insert(0, motion)
            if joint.place != IN_CHAIN:
                tube.insert(0, motion)
        return [motion for row in rows for motion in row], tube
