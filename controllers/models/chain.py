"""Kinematics of a chain of driven axes: position and velocity of a point at its end, and what an inertial sensor there measures.

The chain is described in its zero position, where all frames are parallel to the world: axis i is a direction `axes[i]` and a point
`points[i]` on it, measured from the point before. Quantities at the end are in the end's own frame; rotations take them to the world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.compiled import exactly_inlined
from controllers.errors import DesignError
from controllers.models.vectors import Vector, cross, minus, plus, row, scaled, turned_back

UNIT = 1e-6
"""Tolerance on the length of an axis's unit vector."""


@dataclass(frozen=True)
class Chain:
    """Driven axes from the world to the body that is observed.

    Parameters
    ----------
    axes : (n, 3) array
        Unit vectors at position zero, in the world.
    points : (n, 3) array
        A point on each axis at position zero, from the point before it (the first: from the world's origin) [m].
    revolute : (n,) bool array
        False: prismatic, sliding along its axis.
    gravity_m_s2 : (3,) array
        In the world.
    """

    axes: np.ndarray
    points: np.ndarray
    revolute: np.ndarray
    gravity_m_s2: np.ndarray

    def __post_init__(self) -> None:
        """Check shapes, finite numbers and unit axes."""
        n = len(self.axes)
        for name, shape in (("axes", (n, 3)), ("points", (n, 3)), ("revolute", (n,)), ("gravity_m_s2", (3,))):
            fits("chain", name, getattr(self, name), shape)
        if np.abs(np.linalg.norm(self.axes, axis=1) - 1.0).max(initial=0.0) > UNIT:
            raise DesignError("chain: an axis is not a unit vector")


def fits(whose: str, name: str, values: np.ndarray, shape: tuple[int, ...]) -> None:
    """Check that an array has this shape and finite numbers.

    Raises
    ------
    DesignError
        It is not.
    """
    if np.shape(values) != shape:
        raise DesignError(f"{whose}: {name} has shape {np.shape(values)}, {shape} fits")
    if not np.isfinite(values).all():
        raise DesignError(f"{whose}: a number of {name} is not finite")


@exactly_inlined
def carried(omega: Vector, alpha: Vector, r: Vector) -> Vector:
    """Return alpha x r + omega x (omega x r): how acceleration changes from one point of a body to another."""
    return plus(cross(alpha, r), cross(omega, cross(omega, r)))


@exactly_inlined
def chain_motion(
    axes: np.ndarray, points: np.ndarray, revolute: np.ndarray, gravity: np.ndarray, motion: np.ndarray, end: Vector
) -> tuple[Vector, Vector, Vector]:
    """Return angular rate, angular acceleration and specific force at the point `end` of the last frame, in that frame.

    Parameters
    ----------
    axes, points, revolute, gravity : as in `Chain`
    motion : (3 n or more,) array
        Positions, speeds, accelerations of the axes, one after the other.
    end : three floats
        The point, from the last axis's point [m].

    Returns
    -------
    omega, alpha, force : three floats each
        `force` is acceleration minus gravity.
    """
    n = len(revolute)
    omega, alpha, force = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-gravity[0], -gravity[1], -gravity[2])
    for i in range(n):
        axis = row(axes, i)
        q, v, a = motion[i], motion[n + i], motion[2 * n + i]
        force = plus(force, carried(omega, alpha, row(points, i)))
        along = scaled(axis, v)
        if revolute[i]:
            s, c = np.sin(q), np.cos(q)
            omega, force = turned_back(axis, s, c, omega), turned_back(axis, s, c, force)
            alpha = plus(turned_back(axis, s, c, alpha), plus(scaled(axis, a), cross(omega, along)))
            omega = plus(omega, along)
        else:
            force = plus(force, carried(omega, alpha, scaled(axis, q)))
            force = plus(force, plus(scaled(axis, a), scaled(cross(omega, along), 2.0)))
    return omega, alpha, plus(force, carried(omega, alpha, end))


@exactly_inlined
def point_in_world(axes: np.ndarray, points: np.ndarray, revolute: np.ndarray, q: np.ndarray, end: Vector) -> Vector:
    """Return the position in the world of the point `end` of the last frame, axes at q (n,)."""
    position = end
    for i in range(len(revolute) - 1, -1, -1):
        axis = row(axes, i)
        position = turned_back(axis, -np.sin(q[i]), np.cos(q[i]), position) if revolute[i] else plus(position, scaled(axis, q[i]))
        position = plus(position, row(points, i))
    return position


@exactly_inlined
def direction_in_world(axes: np.ndarray, revolute: np.ndarray, q: np.ndarray, direction: Vector) -> Vector:
    """Return a direction of the last frame in the world, axes at q (n,)."""
    for i in range(len(revolute) - 1, -1, -1):
        if revolute[i]:
            direction = turned_back(row(axes, i), -np.sin(q[i]), np.cos(q[i]), direction)
    return direction


@exactly_inlined
def axis_screw(axes: np.ndarray, points: np.ndarray, revolute: np.ndarray, q: np.ndarray, end: Vector, which: int) -> tuple[Vector, Vector]:
    """Return the velocity of the point `end` and the angular rate, in the last frame, per unit speed of axis `which`.

    Together they are a column of the body Jacobian.
    """
    n = len(revolute)
    arm = end
    for i in range(n - 1, which, -1):
        axis = row(axes, i)
        arm = turned_back(axis, -np.sin(q[i]), np.cos(q[i]), arm) if revolute[i] else plus(arm, scaled(axis, q[i]))
        arm = plus(arm, row(points, i))
    turn = row(axes, which)
    shift = cross(turn, arm)
    if not revolute[which]:
        shift, turn = turn, minus(turn, turn)
    for i in range(which + 1, n):
        if revolute[i]:
            s, c = np.sin(q[i]), np.cos(q[i])
            shift, turn = turned_back(row(axes, i), s, c, shift), turned_back(row(axes, i), s, c, turn)
    return shift, turn
