"""Three-dimensional vector algebra on tuples of nodes, as far as the rigid-body equations need it."""

from __future__ import annotations

import numpy as np

from virtual_bus.plant.symbols import Graph, Node

Vector = tuple[Node, Node, Node]
Matrix = tuple[Vector, Vector, Vector]  # rows


def constant_vector(graph: Graph, values: np.ndarray) -> Vector:
    """Return (3,) numbers as nodes."""
    x, y, z = (graph.constant(value) for value in values)
    return x, y, z


def constant_matrix(graph: Graph, values: np.ndarray) -> Matrix:
    """Return (3, 3) numbers as nodes."""
    x, y, z = (constant_vector(graph, row) for row in values)
    return x, y, z


def add(*vectors: Vector) -> Vector:
    """Return the sum of any number of vectors."""
    total = vectors[0]
    for vector in vectors[1:]:
        total = (total[0] + vector[0], total[1] + vector[1], total[2] + vector[2])
    return total


def scale(factor: Node, vector: Vector) -> Vector:
    """Return factor · vector."""
    return factor * vector[0], factor * vector[1], factor * vector[2]


def dot(a: Vector, b: Vector) -> Node:
    """Return a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def transpose(m: Matrix) -> Matrix:
    """Return mᵀ."""
    return (m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2])


def apply(m: Matrix, v: Vector) -> Vector:
    """Return m v."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


def apply_transposed(m: Matrix, v: Vector) -> Vector:
    """Return mᵀ v."""
    return apply(transpose(m), v)


def product(a: Matrix, b: Matrix) -> Matrix:
    """Return a b."""
    columns = transpose(b)
    x, y, z = ((dot(row, columns[0]), dot(row, columns[1]), dot(row, columns[2])) for row in a)
    return x, y, z


def add_matrices(*matrices: Matrix) -> Matrix:
    """Return the sum of any number of matrices."""
    x, y, z = (add(*rows) for rows in zip(*matrices, strict=True))
    return x, y, z


def congruence(rotation: Matrix, symmetric: Matrix) -> Matrix:
    """Return rotation · symmetric · rotationᵀ, with the lower half copied from the upper one."""
    half = product(rotation, symmetric)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = product(half, transpose(rotation))
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


def shifted_inertia(inertia: Matrix, mass: Node, moment: Vector, shift: Vector) -> Matrix:
    """Return the inertia about a new origin.

    `inertia` and the first `moment` are about the old origin, which lies at `shift` from the new one.
    J' = J − m [s][s] − [s][h] − [h][s], with [·] the cross-product matrix (Featherstone 2008, eq. 2.66).
    """
    s, h = shift, moment
    weighted = add(scale(mass, s), scale(h[0].graph.constant(2.0), h))  # m s + 2 h
    trace = dot(s, weighted)

    def off_diagonal(i: int, j: int) -> Node:
        return inertia[i][j] - (mass * s[i] * s[j] + (s[i] * h[j] + s[j] * h[i]))

    def diagonal(i: int) -> Node:
        return inertia[i][i] + (trace - s[i] * weighted[i])

    xy, xz, yz = off_diagonal(0, 1), off_diagonal(0, 2), off_diagonal(1, 2)
    return (diagonal(0), xy, xz), (xy, diagonal(1), yz), (xz, yz, diagonal(2))
