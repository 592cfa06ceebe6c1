"""Which lattice whole numbers lie on that were rounded from it: the points of a digital straight line.

A lattice of step r and offset c, neither of them whole, read by an encoder that counts, gives the numbers n = round(r k + c). Whether there
are r and c for given numbers is a linear problem once every one has its k, |n - r k - c| <= 1/2 (Rosenfeld 1974, IEEE Trans. Comput. 23,
1264-1269, on the digital line; here some of its points are missing).
"""

from __future__ import annotations

import numpy as np
import scipy.optimize

HALF = 0.5 + 1e-6
"""A count, and what readings are written less exactly."""

LEAST, RUNS, SEEDS = 2.0, 30, 5
"""Least step, runs of neighbours that are asked what it is, and those from which the others are numbered, one after the other."""

WHOLE = 1e-9
"""How near a whole step is none that is not: numbers that lie on one have it as their common divisor."""

NUMBERED_ANEW = 30
"""Times that numbers further out are given their k: each time those that the step found before leaves no doubt about."""


def step_of(numbers: np.ndarray) -> tuple[float, float] | None:
    """Smallest and largest step of a lattice that they lie on.

    Parameters
    ----------
    numbers : (M,) int array
        Distinct, in order.

    Returns
    -------
    pair of float or None
        None where there is none of two or more, or where it cannot be said which points are missing: next to a whole step readings lie
        on whole steps for long.
    """
    numbers = np.asarray(numbers, dtype=float) - numbers[len(numbers) // 2]  # near nothing, where least is rounded
    gaps = np.diff(numbers)
    if len(gaps) < 2 or gaps.min() < 2:
        return None
    runs = _runs(gaps <= gaps.min() + 1)[:RUNS]  # of neighbours
    between = LEAST, np.inf
    for first, last in runs:
        ends = _feasible(np.arange(last - first + 1.0), numbers[first : last + 1], between)
        if ends is None:
            return None
        between = ends[0][0], ends[1][0]
    found = (_grown(numbers, first, last, between) for first, last in runs[:SEEDS])
    return next((steps for steps in found if steps is not None), None)


def _grown(numbers: np.ndarray, first: int, last: int, between: tuple[float, float]) -> tuple[float, float] | None:
    """From neighbours outwards: smallest and largest step; None where there is none or it cannot be said which points are missing."""
    known = np.zeros(len(numbers), dtype=bool)
    known[first : last + 1] = True
    k = np.zeros(len(numbers))
    k[first : last + 1] = np.arange(last - first + 1)
    for _ in range(NUMBERED_ANEW):
        lattices = _feasible(k[known], numbers[known], between)
        if lattices is None:
            return None
        if known.all():
            low, high = lattices[0][0], lattices[1][0]
            return None if np.floor(high + WHOLE) >= low - WHOLE else (low, high)
        first_k, other_k = (np.rint((numbers - offset) / step) for step, offset in lattices)
        sure = known | (first_k == other_k)
        if sure.sum() == known.sum():
            return None
        k, known = np.where(known, k, first_k), sure
    return None


def _runs(holds: np.ndarray) -> list[tuple[int, int]]:
    """Where they begin and end, the longest first."""
    edges = np.diff(np.concatenate([[0], holds.astype(int), [0]]))
    starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    order = np.argsort(starts - ends, kind="stable")
    return [(int(starts[k]), int(ends[k])) for k in order]


def _feasible(k: np.ndarray, numbers: np.ndarray, between: tuple[float, float]) -> list[tuple[float, float]] | None:
    """(r, c) of |n - r k - c| <= 1/2 with the smallest and with the largest r between these; None where there is no such lattice. k in
    order.
    """
    below, above = _hull(k, numbers + HALF), _hull(k, HALF - numbers)  # a line is below all points where it is below their hull
    rows = [np.column_stack([sign * k[kept], np.full(len(kept), sign)]) for sign, kept in ((1.0, below), (-1.0, above))]
    right = np.concatenate([numbers[below] + HALF, HALF - numbers[above]])
    ends = [scipy.optimize.linprog([way, 0.0], A_ub=np.vstack(rows), b_ub=right, bounds=[between, (None, None)]) for way in (1.0, -1.0)]
    return None if any(end.x is None for end in ends) else [(float(end.x[0]), float(end.x[1])) for end in ends]


def _hull(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Which points are corners of the lower convex hull, x in order (Andrew 1979, Inform. Process. Lett. 9, 216-219)."""
    kept: list[int] = []
    for i in range(len(x)):
        while len(kept) > 1:
            a, b = kept[-2:]
            if (x[b] - x[a]) * (y[i] - y[a]) > (y[b] - y[a]) * (x[i] - x[a]):
                break
            kept.pop()
        kept.append(i)
    return np.array(kept)
