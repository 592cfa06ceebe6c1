"""Vectors of three as tuples, which the compiler keeps in registers."""

from __future__ import annotations

import numpy as np

from controllers.compiled import exactly_inlined

Vector = tuple[float, float, float]


@exactly_inlined
def row(table: np.ndarray, i: int) -> Vector:
    """Return row i of a table (n, 3)."""
    return table[i, 0], table[i, 1], table[i, 2]


@exactly_inlined
def scaled(a: Vector, factor: float) -> Vector:
    """Return the product of a vector and a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@exactly_inlined
def plus(a: Vector, b: Vector) -> Vector:
    """Return the sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@exactly_inlined
def minus(a: Vector, b: Vector) -> Vector:
    """Return the difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@exactly_inlined
def dot(a: Vector, b: Vector) -> float:
    """Return the dot product a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@exactly_inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@exactly_inlined
def turned_back(axis: Vector, s: float, c: float, v: Vector) -> Vector:
    """Return Rᵀ v by Rodrigues' formula, R turning about `axis` by the angle of sine s and cosine c; with -s it returns R v."""
    along = (axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2]) * (1.0 - c)
    x, y, z = cross(axis, v)
    return c * v[0] - s * x + along * axis[0], c * v[1] - s * y + along * axis[1], c * v[2] - s * z + along * axis[2]
