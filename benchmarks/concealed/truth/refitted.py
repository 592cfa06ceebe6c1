"""The nearest of a family of simulations: bounded least squares whose derivatives are taken once and corrected by every run."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.optimize

RUNS = 15
"""Simulations at most, of one descent."""

FIRST_RADIUS = 0.5
"""Of a first step, as a share of each unknown's size."""

LEAST_RADIUS = 1e-3

DIFFERENCE = 0.05
"""Of derivatives that are taken anew, as a share of each unknown's size."""

SURPRISED = 0.3
"""Share of what is left by which a simulation was not the expected one, from which on derivatives are taken anew."""

WORTH = 0.01
"""Share of the distance by which the next step must promise to shorten it."""


def nearest(
    leaves: Callable[[np.ndarray], np.ndarray | None],
    begun: np.ndarray,
    columns: Sequence[np.ndarray],
    bounds: tuple[np.ndarray, np.ndarray],
    sizes: np.ndarray,
    enough: float,
) -> float:
    """Shortest length of what a family of simulations leaves that was found.

    Gauss-Newton's steps in a trust region, with Broyden's correction of the derivatives (Nocedal and Wright 2006, ch. 10 and 11). Where it
    ends after a simulation that was not the expected one, derivatives are taken anew there, once.

    Parameters
    ----------
    leaves : callable
        Unknowns (P,) -> what is left beside them (M,); None where the simulation runs away.
    begun : (M,) array
        leaves(0).
    columns : sequence of P (M,) arrays
        What each unknown takes away of it, per unit, near 0.
    bounds : pair of (P,) arrays
        Around 0.
    sizes : (P,) array
        How far an unknown goes within a family of ordinary members.
    enough : float
        A length below which nobody looks further.
    """
    at, left = np.zeros(len(sizes)), begun
    if not columns:
        return float(np.linalg.norm(begun))
    table = -np.column_stack(columns) * sizes
    at, left, table, surprise = _descended(leaves, at, left, table, bounds, sizes, enough)
    length = float(np.linalg.norm(left))
    if length > enough and surprise > SURPRISED * length:
        table = _derived(leaves, at, left, table, bounds[0], sizes)
        at, left, _, _ = _descended(leaves, at, left, table, bounds, sizes, enough)
    return float(np.linalg.norm(left))


def _descended(
    leaves: Callable[[np.ndarray], np.ndarray | None],
    at: np.ndarray,
    left: np.ndarray,
    table: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    sizes: np.ndarray,
    enough: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Where it ends, what is left there, the derivatives, and the largest length by which a simulation was not the expected one."""
    shortest, radius, surprise = float(np.linalg.norm(left)), FIRST_RADIUS, 0.0
    for _ in range(RUNS):
        if shortest < enough or radius < LEAST_RADIUS:
            break
        basis, triangle = np.linalg.qr(table)
        box = np.maximum((bounds[0] - at) / sizes, -radius), np.minimum((bounds[1] - at) / sizes, radius) + 1e-12
        step = scipy.optimize.lsq_linear(triangle, -(basis.T @ left), box).x
        expected = left + table @ step
        if float(np.linalg.norm(expected)) > (1.0 - WORTH) * shortest and float(np.abs(step).max()) < 0.9 * radius:
            break
        tried = leaves(at + step * sizes)
        if tried is None:
            radius = 0.3 * float(np.abs(step).max())
            continue
        surprise = max(surprise, float(np.linalg.norm(tried - expected)))
        table = table + np.outer(tried - expected, step / float(step @ step))
        if float(np.linalg.norm(tried)) < shortest:
            at, left, shortest = at + step * sizes, tried, float(np.linalg.norm(tried))
            radius *= 1.5
        else:
            radius = 0.4 * float(np.abs(step).max())
    return at, left, table, surprise


def _derived(
    leaves: Callable[[np.ndarray], np.ndarray | None],
    at: np.ndarray,
    left: np.ndarray,
    table: np.ndarray,
    low: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """Derivatives there, per size of each unknown, downwards but at a lower bound; those that were known where the simulation runs away."""
    anew = table.copy()
    for k, size in enumerate(sizes):
        way = DIFFERENCE if at[k] - DIFFERENCE * size < low[k] else -DIFFERENCE
        moved = at.copy()
        moved[k] += way * size
        tried = leaves(moved)
        if tried is not None:
            anew[:, k] = (tried - left) / way
    return anew
