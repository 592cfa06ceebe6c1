"""The shortest delay T of a harmonic filter with one tap fewer than equations, (7.27)-(7.30), without an initial guess.

With one gain fewer than equations, the conditions Phi(T) A = b have a solution only where the bordered matrix [Phi(T) b] is
singular: its determinant is a real function of T alone. All its roots in a range are bracketed on a grid finer than its fastest term and
polished, touching ones by their minima, and each is kept if gains exist there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.optimize

from controllers.errors import DesignError
from controllers.shapers.conditions import Condition, equations, solve
from controllers.shapers.delays import DelayFilter
from controllers.shapers.dynamics import Dynamics
from controllers.shapers.harmonic_time_delay import tap_count

GRID_PER_RADIAN = 8
"""Points per radian of the fastest term of the determinant: sum over the conditions' frequencies times their taps."""

GRID_LIMIT = 200_000

AT_A_TIME = 2000
"""Points whose matrices are in memory together."""

TOUCHING = 1e-1
"""A local minimum of the determinant's size below this, relative to its neighbourhood, may be a root that does not change sign."""

ROUNDING = 1e-13
"""Size of the determinant, relative to its largest, below which its sign means nothing."""

SAME = 1e-9
"""Two roots closer than this, relatively, are one."""

NAME = "hTDF, shortest"


def shortest_delays(
    conditions: Sequence[Condition],
    longest_s: float,
    *,
    tail: Dynamics | None = None,
    gain_sum_limit: float = np.inf,
    count: int | None = None,
) -> list[DelayFilter]:
    """Return every filter with L = N_p + 2 N_w - 2 whose delay is at most `longest_s`, shortest first.

    Parameters
    ----------
    conditions : from `harmonic_conditions`.
    longest_s : end of the range of T that is searched.
    gain_sum_limit : solutions with a larger sum of |A_k| are dropped, because the gains go to infinity as T goes to zero.
    count : only so many, the shortest; all unless given.

    Raises
    ------
    DesignError
        No solution in the range.
    """
    taps = tap_count(conditions) - 1
    if taps < 1:
        raise DesignError("the shortest delay needs at least two equations")

    def determinants(delays_s: np.ndarray) -> np.ndarray:
        matrix, right = equations(conditions, delays_s[:, None, None] * np.arange(taps), tail)
        found: np.ndarray = np.linalg.det(np.concatenate([matrix, right[..., None]], axis=-1))
        return found

    fastest = max(abs(condition.s) for condition in conditions) * taps
    points = int(np.clip(longest_s * fastest * GRID_PER_RADIAN, 200, GRID_LIMIT))
    grid = longest_s * np.arange(1, points + 1) / points
    values = np.concatenate([determinants(part) for part in np.array_split(grid, points // AT_A_TIME + 1)])
    found: list[DelayFilter] = []
    for delay in _candidates(lambda delay: float(determinants(np.array([delay]))[0]), grid, values):
        if len(found) == count:
            break
        try:
            shaper = _polished(conditions, delay, taps, tail)
        except DesignError:
            continue  # the taps are dependent there, and the right-hand side is not in their span
        again = any(abs(each.delays_s[1] / shaper.delays_s[1] - 1.0) < SAME for each in found)
        if not again and shaper.gain_sum <= gain_sum_limit and shaper.delays_s[1] <= longest_s:
            found.append(shaper)
    if not found:
        raise DesignError(f"no delay up to {longest_s:.4g} s meets all conditions with {taps} taps and gains up to {gain_sum_limit:.4g}")
    return sorted(found, key=lambda shaper: shaper.transient_s)


def _polished(conditions: Sequence[Condition], delay_s: float, taps: int, tail: Dynamics | None) -> DelayFilter:
    """Solve for gains and delay together, from a delay that is nearly right: a touching root is found to half the digits only."""
    try:
        return solve(conditions, delay_s * np.arange(taps), tail, NAME)
    except DesignError:
        matrix, right = equations(conditions, delay_s * np.arange(taps), tail)
        start = np.append(np.linalg.lstsq(matrix, right, rcond=None)[0], delay_s)

    def missed(unknown: np.ndarray) -> np.ndarray:
        matrix, right = equations(conditions, unknown[-1] * np.arange(taps), tail)
        residual: np.ndarray = matrix @ unknown[:-1] - right
        return residual

    best = scipy.optimize.least_squares(missed, start, jac="3-point", method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return solve(conditions, best[-1] * np.arange(taps), tail, NAME)


def _candidates(function: Callable[[float], float], grid: np.ndarray, values: np.ndarray) -> list[float]:
    """Return roots of a function with these values on a grid, and minima of its size that may only touch zero, in rising order."""
    size = np.abs(values)
    told = size > ROUNDING * size.max()  # as T goes to zero all taps become one and the determinant is lost in rounding
    crossing = np.flatnonzero((np.sign(values[:-1]) * np.sign(values[1:]) < 0.0) & told[:-1] & told[1:])
    roots = [_root(function, grid[k], grid[k + 1]) for k in crossing]
    roots += [float(grid[k]) for k in np.flatnonzero(values == 0.0)]
    for k in np.flatnonzero((size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:])) + 1:
        if told[k] and k not in crossing and k - 1 not in crossing and size[k] < TOUCHING * size[max(0, k - 50) : k + 50].max():
            side = np.sign(values[k])
            low = scipy.optimize.minimize_scalar(
                lambda t, side=side: side * function(t), bounds=(grid[k - 1], grid[k + 1]), options={"xatol": 1e-12}
            )
            if low.fun < 0.0:  # two roots between neighbours of the grid
                roots += [_root(function, end, low.x) for end in (grid[k - 1], grid[k + 1])]
            else:
                roots.append(float(low.x))
    return sorted(roots)


def _root(function: Callable[[float], float], start: float, end: float) -> float:
    return float(scipy.optimize.brentq(function, start, end, xtol=1e-15, rtol=8.9e-16, disp=False))
