"""A covariance one row later, and the products of small matrices that it takes, compiled."""

from __future__ import annotations

import numba
import numpy as np

from virtual_bus.compilation.jit import OUTER, Compiler

exactly_compiled: Compiler = numba.njit(cache=True, fastmath=False, **OUTER)
quickly_compiled: Compiler = numba.njit(cache=True, fastmath=True, nogil=True, **OUTER)


@quickly_compiled
def times(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Write the product of two small matrices; their zeros cost nothing."""
    for i in range(a.shape[0]):
        out[i, :] = 0.0
        for k in range(a.shape[1]):
            weight = a[i, k]
            if weight != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += weight * b[k, j]


@quickly_compiled
def times_transposed(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Write a b'."""
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[j, k]
            out[i, j] = total


@quickly_compiled
def transposed_times(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    """Write a' b; zeros of a cost nothing."""
    out[:] = 0.0
    for k in range(a.shape[0]):
        for i in range(a.shape[1]):
            weight = a[k, i]
            if weight != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += weight * b[k, j]


@exactly_compiled
def inverse_root(s: np.ndarray, out: np.ndarray) -> bool:
    """Write the inverse of the lower Cholesky factor of a small matrix, and return whether it has one; `s` is overwritten."""
    size = len(s)
    for i in range(size):
        for j in range(i + 1):
            for k in range(j):
                s[i, j] -= s[i, k] * s[j, k]
            if i > j:
                s[i, j] /= s[j, j]
            elif s[i, i] > 0.0:
                s[i, i] = np.sqrt(s[i, i])
            else:
                return False
    for j in range(size):
        out[j, j] = 1.0 / s[j, j]
        for i in range(j + 1, size):
            total = 0.0
            for k in range(j, i):
                total -= s[i, k] * out[k, j]
            out[i, j] = total / s[i, i]
    return True


@quickly_compiled
def propagated(
    p: np.ndarray,
    transition: np.ndarray,
    of_effort: np.ndarray,
    process: np.ndarray,
    extra: np.ndarray,
    jolts: np.ndarray,
    k: int,
    work: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the covariance one row later, symmetric to the last bit."""
    size = len(p)
    times(transition, p, work)
    times_transposed(work, transition, out)
    for i in range(size):
        for j in range(i):
            mean = 0.5 * (out[i, j] + out[j, i])
            out[i, j] = mean
            out[j, i] = mean
        out[i, i] += process[i]
        if len(extra) > 1:
            out[i, i] += extra[k, i]
    if len(jolts) > 1:
        for j in range(jolts.shape[1]):
            if jolts[k, j] > 0.0:
                for i in range(size):
                    for c in range(size):
                        out[i, c] += jolts[k, j] * of_effort[i, j] * of_effort[c, j]
