"""Small dense matrices whose size the compiler knows."""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled


@compiled
def multiply(matrix: np.ndarray, vector: np.ndarray, product: np.ndarray) -> None:
    """Multiply: product = matrix vector."""
    for i in range(len(product)):
        total = 0.0
        for j in range(len(product)):
            total += matrix[i, j] * vector[j]
        product[i] = total


@compiled
def invert(mass: np.ndarray, pivots: np.ndarray, inverse: np.ndarray) -> None:
    """Invert the symmetric positive definite `mass` (lower half given) by its L D Lᵀ factors.

    `mass` is overwritten.
    """
    n = len(pivots)
    for j in range(n):
        for i in range(j, n):
            total = mass[i, j]
            for k in range(j):
                total -= mass[i, k] * mass[j, k] * pivots[k]
            if i == j:
                pivots[j] = total
                mass[j, j] = 1.0 / total
            else:
                mass[i, j] = total * mass[j, j]
    for j in range(n):  # rows of the inverse of L, transposed into the upper half
        for i in range(j + 1, n):
            total = -mass[i, j]
            for k in range(j + 1, i):
                total -= mass[i, k] * mass[j, k]
            mass[j, i] = total
    for i in range(n):
        for j in range(i + 1):
            total = mass[i, i] if i == j else mass[j, i] * mass[i, i]
            for k in range(i + 1, n):
                total += mass[i, k] * mass[j, k] * mass[k, k]
            inverse[i, j] = total
            inverse[j, i] = total
