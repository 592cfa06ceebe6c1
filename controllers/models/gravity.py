"""Efforts of gravity at the joints of a tree of rigid bodies: forces at the centres of mass, carried to the joints (2.14).

The thesis puts the load at the end of the chain (2.14). At the isocentre, where the axes of a C-arm meet, that load would have no lever
arm (correction to (2.15), (2.16)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class GravityTree:
    """A tree of rigid bodies, parents first.

    Attributes
    ----------
    parent : (b,) int array
        -1: the world.
    position_m, orientation : (b, 3), (b, 3, 3) arrays
        Pose of the body's frame in its parent's, joint at zero.
    axis : (b, 3) array
        Axis of the joint, in the body's frame.
    revolute : (b,) bool array
    coordinate : (b,) int array
        Index of the joint's coordinate; -1: welded.
    mass_kg, center_of_mass_m : (b,), (b, 3) arrays
    gravity_m_s2 : (3,) array
    """

    parent: np.ndarray
    position_m: np.ndarray
    orientation: np.ndarray
    axis: np.ndarray
    revolute: np.ndarray
    coordinate: np.ndarray
    mass_kg: np.ndarray
    center_of_mass_m: np.ndarray
    gravity_m_s2: np.ndarray

    def efforts(self, coordinates: np.ndarray) -> np.ndarray:
        """Return the effort (N, m) of gravity [Nm or N] along each of the coordinates (N, m) [rad or m]."""
        count, bodies = len(coordinates), len(self.parent)
        origin = np.zeros((bodies, count, 3))
        rotation = np.zeros((bodies, count, 3, 3))
        moving = self.coordinate >= 0
        amount = coordinates.T[self.coordinate][:, :, None] * self.axis[:, None, :]
        # Of all bodies at once: a call to SciPy costs what fifty turns do
        turn_by = np.where((moving & self.revolute)[:, None, None], amount, 0.0).reshape(-1, 3)
        turned = Rotation.from_rotvec(turn_by).as_matrix().reshape(rotation.shape)
        for b in range(bodies):
            above = self.parent[b]
            start = np.zeros((count, 3)) if above < 0 else origin[above]
            turn = np.broadcast_to(np.eye(3), (count, 3, 3)) if above < 0 else rotation[above]
            start, turn = start + turn @ self.position_m[b], turn @ self.orientation[b]
            if moving[b] and self.revolute[b]:
                turn = turn @ turned[b]
            elif moving[b]:
                start = start + (turn @ amount[b, :, :, None])[..., 0]
            origin[b], rotation[b] = start, turn
        mass = self.mass_kg.astype(float).copy()
        moment = mass[:, None, None] * (origin + (rotation @ self.center_of_mass_m[:, None, :, None])[..., 0])
        for b in range(bodies - 1, -1, -1):
            if self.parent[b] >= 0:
                mass[self.parent[b]] += mass[b]
                moment[self.parent[b]] += moment[b]
        result = np.zeros_like(coordinates, dtype=float)
        x, y, z = self.gravity_m_s2
        crossed = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # a vector's product with this is its cross product with gravity
        along = (rotation @ self.axis[:, None, :, None])[..., 0]
        weight = mass[:, None, None] * self.gravity_m_s2
        load = np.where(self.revolute[:, None, None], (moment - mass[:, None, None] * origin) @ crossed, weight)
        result[:, self.coordinate[moving]] = np.sum(along * load, axis=2)[moving].T
        return result
