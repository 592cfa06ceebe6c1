"""What effects show in a sensor's readings themselves: a coarser lattice, readings that are held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST_PAIRS = 20.0
"""Events of a kind that chance would have made, of which none is there: it makes none once in e^20."""
APART = 1.5
"""Steps of the file's lattice between neighbouring readings, below which they are neighbours on it."""
FASTEST = 4.0
"""Steps of a lattice, rms over NEARBY rows, from which on no change and a change by one step are as seldom."""
NEARBY = 25
"""Rows over which means are taken: few enough that a motion is nearly even over them."""
MADE_UP = 1.5
"""Of the changes beside it: a position that was held for a row then changes by two rows' worth."""


@dataclass(frozen=True, eq=False)
class Readings:
    """One channel of several recordings.

    Attributes
    ----------
    values : tuple of (N,) arrays
        NaN where a reading is missing.
    step : float
        Of the lattice that the readings are on.
    is_position : bool
        Whether it is a joint's: its changes add up.
    """

    values: tuple[np.ndarray, ...]
    step: float
    is_position: bool = False


@dataclass(frozen=True, eq=False)
class Shown:
    """An effect that readings show.

    Attributes
    ----------
    values : dict of str to (float, float, float)
        Of each parameter: value, and the ends of its 95 % interval.
    step : float
        Of the lattice that the readings are on with it.
    held : tuple of (N,) bool arrays
        Which readings it held, one array a recording.
    said : str
        What shows it.
    """

    values: dict[str, tuple[float, float, float]]
    step: float
    held: tuple[np.ndarray, ...]
    said: str


@dataclass(frozen=True, eq=False)
class Held:
    """Held readings of one channel of several recordings.

    Attributes
    ----------
    readings : tuple of (N,) bool arrays
        Which may be held.
    count, most : int
        How many were, and may have been, in rows in which it shows.
    rows : int
        In which it shows.
    """

    readings: tuple[np.ndarray, ...]
    count: int
    most: int
    rows: int


def coarser_lattice(readings: Readings) -> tuple[float, float, int] | None:
    """Return the step of a lattice that is coarser than the known one, how unsure it is, and how many of its steps were seen.

    None where readings are on the known lattice. Motions read off a fine lattice have neighbours on it: were the readings spread over it,
    LEAST_PAIRS pairs of them at least would be closer than the closest are.
    """
    values = np.concatenate([each[np.isfinite(each)] for each in readings.values])
    seen = np.unique(values)
    if len(seen) < 2 or readings.step <= 0.0:
        return None
    gaps = np.diff(seen)
    gaps = gaps[gaps > 0.5 * readings.step]  # digits of a text file
    least = float(gaps.min(initial=np.inf))
    reach = float(seen[-1] - seen[0])
    if not APART * readings.step < least < reach:
        return None
    count = len(gaps)
    if count * -np.expm1(-(least - APART * readings.step) * count / reach) < LEAST_PAIRS:
        return None
    return _lattice(seen, least, readings.step)


def _lattice(seen: np.ndarray, least: float, step: float) -> tuple[float, float, int] | None:
    """Return a lattice that all readings are on to within a step of the fine one, by least squares over ever more of them."""
    close = np.diff(seen)
    close = close[(close > 0.5 * step) & (close < least + 2.0 * step)]
    size, centre = float(np.mean(close)), float(seen[len(seen) // 2])
    away = seen - centre
    reach = 4.0 * size
    while True:
        inside = np.abs(away) <= reach
        number = np.round(away[inside] / size)
        left = away[inside] - size * number
        if np.max(np.abs(left - np.median(left))) > step + 0.25 * (size - step):
            return None
        if inside.all() or np.count_nonzero(inside) >= LEAST_PAIRS:  # a few say less of the size than the mean of all that are close
            size, start = np.polyfit(number, away[inside], 1)
            away = away - start
        if inside.all():
            steps = int(np.ptp(number))
            left = away - size * np.round(away / size)
            return (float(size), step / max(steps, 1), steps) if np.max(np.abs(left)) <= step else None
        reach *= 2.0


def held_readings(readings: Readings) -> Held | None:
    """Return which readings are held; None where none is.

    Where readings change by several steps of their lattice from row to row, whether they move or are noise, they change by none as seldom
    as by one. Held ones do so more often. What a position does not show it makes up for at once, by more than it changes before and after:
    on a coarser lattice all changes are of one size, and a joint that came to rest starts slowly.
    """
    held, count, rows, most, sure, next_to_it = [], 0, 0, 0, 0, 0
    every = np.concatenate(readings.values)
    gaps = np.diff(np.unique(every[np.isfinite(every)]))
    step = max(readings.step, float(gaps.min(initial=np.inf)) if len(gaps) else 0.0)  # digits of a text file may be coarser
    for values in readings.values:
        change = np.diff(values)
        still = np.abs(change) < 0.5 * step
        shows = np.isfinite(change) & (_nearby(change**2) > (FASTEST * step) ** 2)
        none = shows & still
        most += int(np.sum(none))
        if readings.is_position:
            before, made_up, after = _changes_around(np.abs(change), still)
            sure += int(np.sum(none & (made_up > MADE_UP * np.maximum(before, after))))
            none &= made_up > MADE_UP * _nearby(np.abs(change))  # where several are lost, those before and after are made up for, too
        else:
            sure += int(np.sum(none))
        count += int(np.sum(none))
        moving = _nearby(np.abs(change)) > step  # any of those may have been held, too
        held.append(np.append(False, none | (still & moving)))
        rows += int(np.sum(shows))
        next_to_it += int(np.sum(shows & ~still & (np.abs(change) < 1.5 * step)))
    expected = float(next_to_it)  # twice what chance makes: steps up and steps down
    if sure <= expected + LEAST_PAIRS + 5.0 * np.sqrt(expected):
        return None
    return Held(tuple(held), count, most, rows)


def _changes_around(size: np.ndarray, still: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for each row the last change before it that is none of the still ones, the first one after, and what follows it; 0: none."""
    number = np.arange(len(size))
    moved = ~still & np.isfinite(size)
    before = np.append(-1, np.maximum.accumulate(np.where(moved, number, -1))[:-1])
    after = np.append(np.minimum.accumulate(np.where(moved, number, len(size))[::-1])[::-1][1:], len(size))
    known = np.append(np.nan_to_num(size), [0.0, 0.0])  # -1 and N point to nothing
    return known[before], known[after], known[np.minimum(after + 1, len(size) + 1)]


def _nearby(values: np.ndarray) -> np.ndarray:
    """Return means over the rows nearby."""
    window = np.ones(min(NEARBY, len(values)))
    sums = np.convolve(np.nan_to_num(values), window, mode="same")
    means: np.ndarray = sums / np.convolve(np.ones(len(values)), window, mode="same")
    return means


def runs(held: Sequence[np.ndarray]) -> np.ndarray:
    """Return how many held readings there are on end, for each time that some are."""
    lengths = []
    for each in held:
        ends = np.flatnonzero(np.diff(np.concatenate(([False], each, [False])).astype(int)))
        lengths.append(ends[1::2] - ends[::2])
    return np.concatenate(lengths)
