"""Vectors of three as tuples: the compiler keeps them in registers."""

from __future__ import annotations

from controllers.compiled import exactly_inlined


@exactly_inlined
def row(table, i):
    """Row i of a table (n, 3)."""
    return table[i, 0], table[i, 1], table[i, 2]


@exactly_inlined
def scaled(a, factor):
    """a times a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@exactly_inlined
def plus(a, b):
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@exactly_inlined
def minus(a, b):
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@exactly_inlined
def dot(a, b):
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@exactly_inlined
def cross(a, b):
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@exactly_inlined
def turned_back(axis, s, c, v):
    """Rᵀ v by Rodrigues' formula, for the rotation R about `axis` by the angle of sine s and cosine c. With -s: R v."""
    along = (axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2]) * (1.0 - c)
    x, y, z = cross(axis, v)
    return c * v[0] - s * x + along * axis[0], c * v[1] - s * y + along * axis[1], c * v[2] - s * z + along * axis[2]
