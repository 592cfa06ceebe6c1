"""Several senders of one signal, told apart by their rates and by what they say.

A signal goes on from sample to sample. Where it leaves its neighbours and returns, again and again, another sender has its turn; so it has
where two even rates lie between each other and what one says keeps to one side of what the other does.
"""

from __future__ import annotations

import numpy as np

from hil.recording.steps import LOST, ON_RASTER, is_even, usual_change, usual_step

FAR = 20.0
"""Ratio to the usual change from sample to sample beyond which a value does not go on from its neighbour."""

STRETCH = 8
"""Fewest samples between two settings of a clock, and of a sender: one that is set more often gives no time."""

PERSISTENT = 5.0
"""Standard deviations by which samples keep to one side of their neighbours more often than by chance: one in three million."""

_FEWEST_ASIDE = 25
"""Samples beside their neighbours from which that can be told: `PERSISTENT` squared, all on one side."""

_WHOLE_COMB = 0.95
"""Share of its places that a sender's raster has filled."""

_LONGEST_STRIDE = 9
"""Samples of other senders, and one, between two of a sender: more are not tried."""


def there_and_back(values: np.ndarray) -> np.ndarray:
    """Return where (N,) a sample lies far from both its neighbours, on the same side."""
    before, behind = np.diff(values, axis=0)[:-1], np.diff(values, axis=0)[1:]
    scale = usual_change(values)
    with np.errstate(invalid="ignore"):
        leaves = (before * behind < 0.0) & (np.minimum(np.abs(before), np.abs(behind)) > FAR * scale)
    return np.concatenate([[False], leaves.any(axis=1), [False]])


def added(time_s: np.ndarray) -> np.ndarray:
    """Return which samples (N,) stand between two that are one usual step apart."""
    step = usual_step(time_s)
    around = time_s[2:] - time_s[:-2]
    return np.concatenate([[False], around < LOST * step, [False]])


def combs(places: np.ndarray, time_s: np.ndarray, said: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the places of two senders with even rates of their own; nothing where they cannot be told apart.

    All are in order of time: places (N,), time_s (N,), said (N, K).
    """
    return tuple(np.sort(places[part]) for part in _combs(time_s, said))


def persistent_combs(places: np.ndarray, time_s: np.ndarray, said: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the places of two even rates, of which one keeps to one side of the other; parameters as in `combs`."""
    if is_even(time_s):
        return ()
    for parts in (_in_turn(time_s), _combs(time_s, said)):
        if parts and _is_aside(time_s, said, *parts):
            return tuple(np.sort(places[part]) for part in parts)
    return ()


def _in_turn(time_s: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the first and the second sample of each time; nothing unless nearly all times have two."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(time_s) > 0.0]))
    sizes = np.diff(np.append(first, time_s.size))
    return (first, first[sizes > 1] + 1) if np.mean(sizes == 2) > _WHOLE_COMB else ()


def _combs(time_s: np.ndarray, said: np.ndarray) -> tuple[np.ndarray, ...]:
    if time_s.size < 2 * STRETCH:
        return ()
    for start in range(2):
        for stride in range(1, _LONGEST_STRIDE + 1):
            if start + stride >= time_s.size or time_s[start + stride] <= time_s[start]:
                continue
            comb = _comb(time_s, said, start, float(time_s[start + stride] - time_s[start]))
            rest = np.setdiff1d(np.arange(time_s.size), comb)
            if comb.size < STRETCH or rest.size < STRETCH or there_and_back(said[comb]).any() or there_and_back(said[rest]).any():
                continue
            if is_even(time_s[comb]) and is_even(time_s[rest]):
                return comb, rest
    return ()


def _comb(time_s: np.ndarray, said: np.ndarray, start: int, step: float) -> np.ndarray:
    """Return the samples (M,) that follow `start` in steps of `step`, that where several have its time which goes on best."""
    comb, due = [start], time_s[start] + step
    asked = 1
    while due <= time_s[-1]:
        asked += 1
        low, high = np.searchsorted(time_s, (due - ON_RASTER * step, due + ON_RASTER * step))
        near = [place for place in range(low, high) if place > comb[-1]]
        if near:
            last = said[comb[-1]]
            expected = last if len(comb) == 1 else 2.0 * last - said[comb[-2]]
            comb.append(min(near, key=lambda place: float(np.nansum(np.abs(said[place] - expected)))))
            due = time_s[comb[-1]]
        elif len(comb) < _WHOLE_COMB * asked - 1.0:
            return np.zeros(0, dtype=np.int64)
        due += step
    return np.array(comb)


def _is_aside(time_s: np.ndarray, said: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether samples of `other` lie on the same side of both their neighbours of `one`, and the next of them do so again.

    What one sender says between two of its samples lies between them, or beyond by noise and where it turns: on either side in turn. Every
    second sample is taken, so that no two have a neighbour together.
    """
    before = np.searchsorted(time_s[one], time_s[other], side="right") - 1
    inner = (before >= 0) & (before + 1 < one.size)
    low, high, value = said[one[before[inner]]], said[one[before[inner] + 1]], said[other[inner]]
    side = np.where(value > np.maximum(low, high), 1, np.where(value < np.minimum(low, high), -1, 0))
    return any(_goes_on(side[first::2, column]) for column in range(side.shape[1]) for first in range(2))


def _goes_on(side: np.ndarray) -> bool:
    side = side[side != 0]
    again = side[1:] * side[:-1]
    return side.size > _FEWEST_ASIDE and float(again.sum()) > PERSISTENT * float(np.sqrt(again.size))
