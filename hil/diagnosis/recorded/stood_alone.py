"""Runs in which one repeat alone stays, and after which it is beside the others as it was before: lost samples, be it one burst of them.

A joint that sticks in one repeat and not in the others has to catch up with them, as fast as it can: what that repeat reads less than
they do comes and goes row by row. Where samples were lost it grows by what the others move, and is gone within one row, by more than
the channel's motion, or its noise, ever bends. Of a motion that is sampled too coarsely to show how fast it bends nothing is said.
"""

from __future__ import annotations

import numpy as np

from hil.diagnosis.recorded.noise_repeats import runs_of

LEAST_RUN = 4
"""Readings in a row that repeat the one before, of one run at least; then shorter ones are lost too."""

SHORTEST = 2
"""Of such a shorter run."""

FASTER = 2.0
"""Times the largest second difference of any repeat outside of such runs that it falls by: no joint at rest starts so fast."""

SAMPLED = 0.05
"""Of the channel's range, that a step is at most where second differences are accelerations."""

LEFT = 0.2
"""Of that fall, by which both ends of a run may stand apart otherwise."""

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
        Repeat, first row that is lost, and number of such rows; None where there are none or readings are missing.
    """
    repeats, rows = measured.shape
    if repeats < 2 or not np.isfinite(measured).all():
        return None
    same = np.abs(np.diff(measured, axis=1)) <= ROUNDING * np.max(np.abs(measured), initial=0.0)
    runs = [run for run in _runs_alone(same) if run[2] >= SHORTEST and run[1] + run[2] < rows]
    if not runs:
        return None
    apart = np.stack([measured[r] - np.median(np.delete(measured, r, axis=0), axis=0) for r in range(repeats)])
    outside = np.ones_like(same)
    for _, first, lasts in runs:
        outside[:, first - 1 : first + lasts] = False  # in the other repeats as well: of two, either is where the other one is not
    if not outside.any() or np.abs(np.diff(measured, axis=1))[outside].max() > SAMPLED * np.ptp(measured):
        return None
    bends = np.abs(np.diff(measured, n=2, axis=1))[outside[:, 1:] & outside[:, :-1]]
    least = FASTER * float(bends.max(initial=0.0))
    alone = [run for run in runs if _is_back_at_once(apart[run[0]], run, least)]
    return np.array(alone) if any(run[2] >= LEAST_RUN for run in alone) else None


def _is_back_at_once(apart: np.ndarray, run: tuple[int, int, int], least: float) -> bool:
    """Whether what one repeat reads more than the others falls by so much within the row behind the run, to what it was before the run."""
    _, first, lasts = run
    end = first + lasts
    fall = abs(apart[end] - apart[end - 1])
    return bool(fall > least and abs(apart[end] - apart[first - 1]) < LEFT * fall)


def _runs_alone(same: np.ndarray) -> list[tuple[int, int, int]]:
    """Repeat, first row and number of rows to the end of every run that repeats a reading, from the first row in which most others move,
    each of which does so for more than half of what follows of it.
    """
    found = []
    for repeat, begin, lasts in runs_of(same).tolist():
        move = ~np.delete(same, repeat, axis=0)[:, begin : begin + lasts]
        follow = np.cumsum(move[:, ::-1], axis=1)[:, ::-1] / np.arange(lasts, 0, -1)
        starts = np.flatnonzero((move.mean(axis=0) > 0.5) & (follow > 0.5).all(axis=0))
        if len(starts):
            found.append((repeat, begin + int(starts[0]) + 1, lasts - int(starts[0])))
    return found
