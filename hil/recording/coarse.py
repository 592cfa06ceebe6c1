"""Clocks that count slower than samples come: neighbouring samples have equal stamps, and are spread evenly."""

from __future__ import annotations

import numpy as np

from hil.recording.senders import FAR
from hil.recording.steps import CLOSE, COARSE, LOST, equal_rows, usual_change, usual_step

_RECURS = 2
"""Fewest equal stamps that a slower clock is known by: one alone can be a clock that was set."""


def is_coarse_clock(time_s: np.ndarray, values: np.ndarray | None) -> bool:
    """Return whether samples of an even rate have equal stamps now and then, as the clock counts slower, and go on there as beside."""
    if values is None or _evenly(time_s) is None:
        return False
    with np.errstate(invalid="ignore"):
        change = np.nan_to_num(np.abs(np.diff(values, axis=0)) / usual_change(values))
    alike = np.flatnonzero(np.diff(time_s) == 0.0)
    alike = alike[(alike > 0) & (alike < len(change) - 1)]
    beside = 0.5 * (change[alike - 1] + change[alike + 1])
    return bool(np.all(change[alike] <= FAR) and change[alike].sum() >= CLOSE * beside.sum())


def spread(time_s: np.ndarray, steady: np.ndarray, said: np.ndarray) -> np.ndarray | None:
    """Return times (N,) at which samples with equal stamps are spread; None where no clock that counts slower explains them.

    `said` (N, K) is what they say, `steady` (N, J) that of it which does not jump.
    """
    if is_coarse_clock(time_s, steady):
        return _evenly(time_s)
    alike = np.concatenate([[False], np.diff(time_s) <= 0.0])
    same = alike & np.concatenate([[False], equal_rows(said[1:], said[:-1])])
    if np.mean(alike) < COARSE or np.count_nonzero(same) >= CLOSE * np.count_nonzero(alike) or not _is_in_groups(time_s):
        return None
    between_s: np.ndarray = np.interp(np.arange(time_s.size), np.flatnonzero(~alike), time_s[~alike])
    tail = int(np.flatnonzero(~alike)[-1])
    step = float(time_s[tail] - time_s[0]) / tail
    between_s[tail:] = time_s[tail] + step * np.arange(time_s.size - tail)
    return between_s


def _is_in_groups(time_s: np.ndarray) -> bool:
    """Return whether equal stamps come in groups of one size, or two neighbouring ones."""
    _, sizes = np.unique(time_s, return_counts=True)
    inner = sizes[1:-1]
    return bool(inner.size and inner.max() - inner.min() <= 1)


def spread_runs(stamps_s: np.ndarray, values: np.ndarray, falls: np.ndarray) -> np.ndarray | None:
    """Return stamps (N,) spread within each of the stretches that begin at `falls`; None where the longest's clock is fine."""
    runs = np.split(stamps_s, falls)
    longest = max(range(len(runs)), key=lambda place: runs[place].size)
    if not is_coarse_clock(runs[longest], np.split(values, falls)[longest]):
        return None
    period_s = usual_step(even_s) if (even_s := _evenly(runs[longest])) is not None else 0.0
    spread_s = [_evenly(run, period_s) for run in runs]
    return np.concatenate([run if even_s is None else even_s for run, even_s in zip(runs, spread_s, strict=True)])


def told(alike: int, what: str) -> str:
    """Return the note on samples that were spread."""
    return f"the stamps are coarser than the {what}s, {alike} {'has' if alike == 1 else 'have'} that of the one before: spread evenly"


def _evenly(time_s: np.ndarray, period_s: float | None = None) -> np.ndarray | None:
    """Return even times (N,) where a clock that counts slower than the samples explains equal stamps; `period_s` is theirs, if known.

    The stamps then lie within a count of even times, and equal ones are more than steps of two counts make up for. Such a step is either
    jitter that does so, or a sample that was lost: both are tried.
    """
    steps, step = np.diff(time_s), usual_step(time_s)
    equal, double = np.count_nonzero(steps == 0.0), np.count_nonzero((steps > LOST * step) & (steps < (1.0 + LOST) * step))
    for gap, many in ((LOST, equal if double < CLOSE * equal else 0), (1.0 + LOST, equal - double)):
        if (many < _RECURS and period_s is None) or not step or np.any(steps < 0.0):
            continue
        lost = steps > gap * step
        passed = np.where(lost, np.maximum(1.0, np.rint(steps / (period_s or np.mean(steps[~lost])))), 1.0)
        count = np.concatenate([[0.0], np.cumsum(passed)])
        even_s: np.ndarray = time_s[0] + (period_s or _rate_s(count[1:][steps == 0.0], time_s[1:][steps == 0.0])) * count
        if np.ptp(time_s - even_s) < LOST * step:
            return even_s
    return None


def _rate_s(count: np.ndarray, time_s: np.ndarray) -> float:
    """Return the time of a count, of samples with the stamp of the one before: they come at nearly the same place between two stamps."""
    count = count - np.mean(count)
    return float(count @ (time_s - np.mean(time_s)) / (count @ count))
