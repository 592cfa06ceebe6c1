"""Runs in which one repeat alone stays where it was, and after which it is where the others are: lost samples, be it one burst of them.

A machine that sticks in one repeat and not in the others has to catch up with them: what that repeat reads less than they do comes and goes
row by row. Where samples were lost it grows by what the others move and is gone within one row, by more than it ever changes elsewhere.
"""

from __future__ import annotations

import numpy as np

LEAST_RUN = 3
"""Readings in a row that repeat the one before."""

BACK_AT_ONCE = 8.0
"""Times the largest change from row to row of what repeats differ by, outside of such runs, that it falls by behind one."""

LEFT = 0.2
"""Of that fall, that may be left behind the run."""

ROUNDING = 1e-12
"""Of the largest reading, by which two of one value may differ."""


def stood_alone(measured: np.ndarray) -> np.ndarray | None:
    """Look for such runs of one channel.

    Parameters
    ----------
    measured : (R, N) array
        Repeats.

    Returns
    -------
    (K, 3) int array or None
        Repeat, first row that repeats the one before, and number of such rows; None where there are none or readings are missing.
    """
    repeats, rows = measured.shape
    if repeats < 2 or not np.isfinite(measured).all():
        return None
    same = np.abs(np.diff(measured, axis=1)) <= ROUNDING * np.max(np.abs(measured), initial=0.0)
    runs = [run for run in _runs(same) if run[2] >= LEAST_RUN and run[1] > 1 and run[1] + run[2] < rows]
    if not runs:
        return None
    apart = np.stack([measured[r] - np.median(np.delete(measured, r, axis=0), axis=0) for r in range(repeats)])
    changes = np.abs(np.diff(apart, axis=1))
    outside = np.ones_like(changes, dtype=bool)
    for _, first, lasts in runs:
        outside[:, first - 1 : first + lasts] = False  # in the other repeats as well: of two, either is where the other one is not
    if not outside.any():
        return None
    least = max(BACK_AT_ONCE * float(changes[outside].max()), _lattice(measured))
    alone = [run for run in runs if _is_back_at_once(apart[run[0]], run, least) and _others_move(same, run)]
    return np.array(alone) if alone else None


def _is_back_at_once(apart: np.ndarray, run: tuple[int, int, int], least: float) -> bool:
    """Whether one repeat falls back to the others by so much within the row behind the run."""
    _, first, lasts = run
    end = first + lasts
    fall = abs(apart[end] - apart[end - 1])
    return bool(fall > least and abs(apart[end]) < LEFT * fall and abs(apart[first - 1]) < LEFT * fall)


def _others_move(same: np.ndarray, run: tuple[int, int, int]) -> bool:
    """Whether no other repeat has a run of its own there."""
    repeat, first, lasts = run
    others = np.delete(same, repeat, axis=0)[:, first - 1 : first - 1 + lasts]
    return bool(np.mean(others) < 0.5)


def _lattice(measured: np.ndarray) -> float:
    steps = np.abs(np.diff(measured, axis=1))
    return float(np.min(steps, where=steps > 0.0, initial=np.inf))


def _runs(same: np.ndarray) -> list[tuple[int, int, int]]:
    """Repeat, first row that repeats the one before, and number of such rows."""
    edges = np.diff(np.pad(same.astype(int), ((0, 0), (1, 1))), axis=1)
    first, end = np.argwhere(edges > 0), np.argwhere(edges < 0)
    return [(int(r), int(begin) + 1, int(stop - begin)) for (r, begin), stop in zip(first, end[:, 1], strict=True)]
