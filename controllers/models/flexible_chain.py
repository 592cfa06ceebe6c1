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

STEP = 1e-4
"""Difference step of a coordinate [rad or m]: gravity's efforts are sines of it, so the error is 1e-9 of them."""

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

    def _yields(self, positions: np.ndarray, bent: np.ndarray, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the change of every deflection with each compliance (N, e, e), and with each axis position (N, e, axes).

        The change of gravity's effort with the deflections is included: bent = C effort(positions, bent), differentiated.
        """
        count, axes, elastic = len(positions), positions.shape[1], len(self.elastic)
        columns = [*range(axes), *(joint.coordinate for joint in self.elastic)]
        coordinates = np.zeros((count, axes + elastic))
        coordinates[:, columns] = np.concatenate([positions, bent], axis=1)
        steps = STEP * np.eye(axes + elastic)[columns]
        either = np.concatenate([steps, -steps])[:, None, :] + coordinates
        efforts = self.tree.efforts(either.reshape(-1, axes + elastic)).reshape(2, axes + elastic, count, -1)
        slopes = np.moveaxis((efforts[0] - efforts[1]) / (2.0 * STEP), 0, -1)[:, columns[axes:], :]  # (N, e, axes + e)
        slopes = self.compliance[:, None] * slopes
        stiffer = np.eye(elastic) - slopes[:, :, axes:]
        return np.linalg.solve(stiffer, effort[:, :, None] * np.eye(elastic)), np.linalg.solve(stiffer, slopes[:, :, :axes])

    def poses(self, positions: np.ndarray, swing: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the poses of focal spot and phantom, seen from the panel.

        Parameters
        ----------
        positions : (N, axes) array
            Positions of the machine's axes [rad].
        swing : (N, e) array, optional
            Deflections of the elastic joints [rad or m] beyond those by gravity.

        Returns
        -------
        source, position : (N, 3) arrays
            nu_s^d and nu_ph^d [m].
        rotation : (N, 3, 3) array
            From phantom to detector coordinates.
        """
        return self._poses(positions, self.deflections(positions), swing)

    def _poses(
        self, positions: np.ndarray, deflected: tuple[np.ndarray, np.ndarray], swing: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        chain, tube = self._motions(positions, deflected, swing)
        end = frames_of(chain, len(positions))[-1]
        seen = frames_of(tube, len(positions))[-1]
        return seen[:, :3, :3] @ self.source_m + seen[:, :3, 3], end[:, :3, 3], end[:, :3, :3]

    def jacobian(self, positions: np.ndarray) -> np.ndarray:
        """Return the change (N, 9, p) of source [m], phantom [m] and rotation [rad, detector coordinates] per unit parameter (2.17)."""
        return self.jacobian_of_all(positions)[:, :, : len(self.names)]

    def jacobian_of_all(self, positions: np.ndarray) -> np.ndarray:
        """Return `jacobian`, then the change per axis position [rad] and per deflection of an elastic joint, (N, 9, p + axes + e)."""
        positions = np.atleast_2d(np.asarray(positions, dtype=float))
        return self._jacobian(positions, self.deflections(positions))

    def poses_and_jacobian(
        self, positions: np.ndarray, swing: np.ndarray | None = None
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Return `poses` with a swing, and `jacobian_of_all`, which is without; gravity bends the machine once for both."""
        deflected = self.deflections(positions)
        return self._poses(positions, deflected, swing), self._jacobian(positions, deflected)

    def _jacobian(self, positions: np.ndarray, deflected: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        chain, tube = self._motions(positions, deflected, with_gains=True)
        size, rigid = len(self.names) + positions.shape[1] + len(self.elastic), len(self.chain.names)
        result = np.zeros((len(positions), 9, size))
        frames = frames_of(chain, len(positions))
        result[:, 3:] = motion_jacobian(chain, frames, frames[-1][:, :3, 3], size)
        frames = frames_of(tube, len(positions))
        source = frames[-1][:, :3, :3] @ self.source_m + frames[-1][:, :3, 3]
        result[:, :3] = motion_jacobian(tube, frames, source, size)[:, :3]
        result[:, :3, rigid : rigid + 3] = frames[-1][:, :3, :3]
        return result

    def _motions(
        self,
        positions: np.ndarray,
        deflected: tuple[np.ndarray, np.ndarray],
        swing: np.ndarray | None = None,
        with_gains: bool = False,
    ) -> tuple[list[Motion], list[Motion]]:
        """Return the motions from the panel to the phantom, and from the panel to the tube."""
        rows = self.chain.motions(self.angles(positions))
        bent, effort = deflected
        first = len(self.chain.names) + len(SOURCE_NAMES)
        axes, swings = len(self.names), len(self.names) + len(self.driven)
        if with_gains:
            gains, by_axes = self._yields(positions, bent, effort)
            for axis, joint in enumerate(self.driven):
                if joint >= 0:
                    turn = rows[joint + 1][0]
                    rows[joint + 1][0] = turn._replace(parameters=(*turn.parameters, (axes + axis, self.chain.table[joint, 4])))
        tube: list[Motion] = []
        for k in range(len(self.elastic) - 1, -1, -1):
            elastic = self.elastic[k]
            # A joint that carries the panel by +q makes everything behind it move by -q; the tube itself moves by +q
            sign = 1.0 if elastic.place == AT_TUBE else -1.0
            parameters: tuple[tuple[int, np.ndarray | float], ...] = ()
            if with_gains:
                parameters = (
                    *((first + j, sign * gains[:, k, j]) for j in range(len(self.elastic))),
                    *((axes + axis, sign * by_axes[:, k, axis]) for axis in range(len(self.driven))),
                    (swings + k, sign),
                )
            amount = bent[:, k] if swing is None else bent[:, k] + swing[:, k]
            motion = Motion(elastic.revolute, elastic.axis, sign * amount, parameters, elastic.point_m)
            if elastic.place != AT_TUBE:
                rows[elastic.row].insert(0, motion)
            if elastic.place != IN_CHAIN:
                tube.insert(0, motion)
        return [motion for row in rows for motion in row], tube
