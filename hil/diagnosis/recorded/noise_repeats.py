"""Lost samples of a channel that noise never leaves still: the same reading several times in a row, in one repeat alone.

Where noise of several counts changes every reading, two in a row are the same once in a hundred rows or so, and five never. This asks for
no motion, where `dropout.without_lost_samples` does, and sees losses that are few, down to a single burst. What is quiet at times is told
from what is lost by how far readings move around, by what the other repeats do in the same rows, and by steps of a single count, which
quiet noise makes as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import scipy.stats

AROUND = (31, 65)
"""Rows whose differences say how strong the noise is; half of them may be lost."""

OTHERS = 9
"""Rows of the other repeats whose steps say the same."""

DENSITY = 0.4
"""At zero, of a step of unit variance."""

SAFETY = 2.0
"""Factor on the probability that a reading repeats by itself."""

LARGEST_CHANCE = 0.2
"""Probability of a repeat, safety in it, above which a row says nothing where many runs are seen: noise of three counts."""

LARGEST_OF_A_BURST = 0.5
"""The same of a row in a single burst, whose own rows pass for quieter noise than there is."""

LEAST_RUN = 3
"""Repeats in a row from which on they are no single ones."""

RARELY_MORE = 1e-2
"""Probability with which rows of one strength of noise repeat oftener than they are taken to."""

LONGEST = 8
"""Repeats in a row that are asked for at most."""

LENGTHS = range(1, LONGEST + 1)

AMONG_THEM = 0.25
"""Share of runs that may be by chance where many are seen."""

ROUNDING = 1e-12
"""Of the largest reading, by which two of one value may differ."""

ON_LATTICE = 0.02
"""Of a count, by which steps may miss the lattice: other channels have none."""

AT_ONE_VALUE = 0.5
"""Share of runs at one value, or at both ends of the range, above which it is a dead band, or the ends are limits."""


@dataclass(frozen=True, eq=False)
class Repeated:
    """Readings that repeat the one before more often in a row than noise lets them.

    Attributes
    ----------
    rows : (R, N) bool array
        Readings that are lost: in runs so long that chance makes fewer than one, or few of them.
    runs : int
        Such runs.
    least : int
        Repeats in a row in each of them, or more.
    share : float
        Of the rows that can tell, that are lost.
    ci95 : pair of float
    length : float
        Mean number of samples lost at once.
    """

    rows: np.ndarray
    runs: int
    least: int
    share: float
    ci95: tuple[float, float]
    length: float


def repeated_in_noise(measured: np.ndarray, largest_chance: float) -> Repeated | None:
    """Look for runs of repeated readings.

    Parameters
    ----------
    measured : (R, N) array
        Of one channel; the lattice is its smallest step.
    largest_chance : float
        Probability of as many runs by themselves, of one of the lengths that are looked at, up to which they are losses.

    Returns
    -------
    Repeated or None
        None where nothing is lost so, noise is too small to tell, there is no lattice or no second repeat.
    """
    repeats, rows = measured.shape
    steps = np.diff(measured, axis=1)
    steps[np.abs(steps) <= ROUNDING * np.max(np.abs(measured), initial=0.0)] = 0.0
    moved = np.abs(steps[steps != 0.0])
    if repeats < 2 or rows < 2 * max(AROUND) or not moved.size or not np.isfinite(measured).all():
        return None
    counts = steps / float(moved.min())
    if np.mean(np.abs(counts - np.rint(counts)) > ON_LATTICE) > ON_LATTICE:
        return None
    chance, by_others = (SAFETY * each for each in _chances(counts))
    lively = by_others <= LARGEST_CHANCE  # where the other repeats say so: in a burst's own rows nothing moves
    several = _several(counts, chance, largest_chance)
    if several is None:
        several = _clear(counts, chance, measured, largest_chance)
        if several is None:
            return None
        lost = float(several.runs[:, 2].sum())
    else:
        lost = float(np.sum(counts[lively] == 0.0)) - float(by_others[lively].sum()) / SAFETY
    still = runs_of((counts == 0.0) & (chance <= LARGEST_CHANCE))
    if _is_at_one_value(measured, still if len(still) else several.runs):
        return None
    return _losses(several, max(lost, float(several.runs[:, 2].sum())), max(int(lively.sum()), several.telling), measured.shape)


@dataclass(frozen=True, eq=False)
class _Bursts:
    """`runs` (K, 3) of at least so many repeats, the mean number of samples lost at once, and how many rows can tell."""

    runs: np.ndarray
    least: int
    length: float
    telling: int


def _several(counts: np.ndarray, chance: np.ndarray, largest_chance: float) -> _Bursts | None:
    """Runs of one length or more of which there are more than chance makes; None where there are none."""
    telling = chance <= LARGEST_CHANCE
    still, chance = (counts == 0.0) & telling, chance[telling]
    runs = runs_of(still)
    by_chance = np.array([np.sum(chance**k) for k in LENGTHS]) + _quiet(counts, telling)
    seen = np.array([np.sum(runs[:, 2] >= k) for k in LENGTHS])
    unlikely = (LONGEST - 1) * float(np.min(scipy.stats.poisson.sf(seen[1:] - 1, by_chance[1:])))
    certain = by_chance < np.maximum(1.0, AMONG_THEM * seen)
    if unlikely > largest_chance or not certain.any():
        return None
    least = 1 + int(np.argmax(certain))
    long = runs[runs[:, 2] >= least]
    if not len(long):
        return None
    return _Bursts(long, least, float(np.mean(long[:, 2] - least + 1.0)), chance.size)  # bursts that last go on as if they had just begun


def _quiet(counts: np.ndarray, telling: np.ndarray) -> np.ndarray:
    """(LONGEST,) how many stretches of so many rows have small steps that are not all none."""
    still, near = (counts == 0.0) & telling, (np.abs(counts) < 1.5) & telling
    return np.array([_windows(near, k) - _windows(still, k) for k in LENGTHS])


def _losses(bursts: _Bursts, lost: float, telling: int, shape: tuple[int, ...]) -> Repeated:
    """Of so many lost samples among those rows that can tell."""
    rows = np.zeros(shape, dtype=bool)
    for repeat, first, lasts in bursts.runs.tolist():
        rows[repeat, first + 1 : first + 1 + lasts] = True
    number = max(lost / bursts.length, 1.0)
    # the number of bursts scatters as Poisson's, and their lengths by as much again
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], [number, number + 2.0]) / number
    share = lost / telling
    return Repeated(rows, len(bursts.runs), bursts.least, share, (float(low * share), float(min(high * share, 1.0))), bursts.length)


def _chances(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(R, N - 1) probabilities of a repeat, from steps in counts: by the smallest of what says how strong the noise is, and by the other
    repeats alone.
    """
    third = np.pad(np.abs(np.diff(counts, n=2, axis=1)), ((0, 0), (1, 1)), mode="edge") / np.sqrt(10.0)  # as strong as white noise's steps
    sizes = np.abs(counts)
    spreads = [scipy.ndimage.median_filter(third, size=(1, rows), mode="nearest") for rows in AROUND]
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(sizes, ((0, 0), (OTHERS // 2, OTHERS // 2)), mode="edge"), OTHERS, axis=1)
    others = np.stack([np.median(np.delete(windows, r, axis=0), axis=(0, 2)) for r in range(len(counts))])
    least, others = (DENSITY / np.maximum(spread / 0.6745, 1e-9) for spread in (np.min([*spreads, others], axis=0), others))
    return least, others


def _as_often(still: np.ndarray, chance: np.ndarray) -> np.ndarray:
    """(R, N - 1) how often rows of about as strong a noise repeat once or twice in a row, at most.

    The quietest of what says how strong noise is has it repeat up to twenty times as often as it does: too often for a single burst to be
    told from it.
    """
    octave = np.floor(np.log2(np.maximum(chance, 1e-12))).astype(int)
    octave -= octave.min()
    alone = still.copy()
    for repeat, first, length in runs_of(still).tolist():
        alone[repeat, first : first + length] &= length < LEAST_RUN
    seen, rows = np.bincount(octave[alone], minlength=octave.max() + 1), np.bincount(octave.ravel())
    most = 0.5 * scipy.stats.chi2.ppf(1.0 - RARELY_MORE, 2 * seen + 2) / np.maximum(rows, 1)
    return np.asarray(most[octave])


def _clear(counts: np.ndarray, chance: np.ndarray, measured: np.ndarray, largest_chance: float) -> _Bursts | None:
    """Runs each of which is too unlikely by itself; None where there are none.

    Counted are all stretches of rows that are no likelier still, each as often as chance leaves it so.
    """
    still, telling = counts == 0.0, chance <= LARGEST_OF_A_BURST
    runs = runs_of(still)
    runs = runs[runs[:, 2] >= LEAST_RUN]
    if not len(runs) or not telling.any():
        return None
    each = np.where(telling, np.log(np.clip(np.minimum(chance, _as_often(still, chance)), 1e-12, 1.0)), np.inf)
    stretches = [np.lib.stride_tricks.sliding_window_view(each, k, axis=1).sum(axis=2) for k in LENGTHS]
    every = np.sort(np.concatenate([stretch.ravel() for stretch in stretches]))
    as_likely = np.cumsum(np.exp(-np.where(np.isfinite(every), -every, np.inf)))
    quiet, clear = _quiet(counts, telling), []
    for repeat, first, length in runs[_may_be_lost(runs, measured)].tolist():
        counted = min(length, LONGEST)
        least = stretches[counted - 1][repeat, first : first + length - counted + 1].min()
        by_itself = as_likely[np.searchsorted(every, least, side="right") - 1]
        if np.isfinite(least) and quiet[counted - 1] == 0 and by_itself <= largest_chance:
            clear.append((repeat, first, length))
    if not clear:
        return None
    long = np.array(clear)
    return _Bursts(long, int(long[:, 2].min()), float(long[:, 2].mean()), int(telling.sum()))


def _may_be_lost(runs: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """(K,) of runs (K, 3): not those without effort or at a limit, at an end of the record, or where another repeat stands as well."""
    repeat, first, length = runs.T
    values, end = measured[repeat, first], measured.shape[1] - 1
    inside = (first > 0) & (first + length < end)
    apart = np.array([not np.any((repeat != r) & (first < b + n) & (b < first + length)) for r, b, n in runs.tolist()])
    return inside & apart & ~np.isin(values, (0.0, measured.min(), measured.max()))


def _windows(small: np.ndarray, length: int) -> int:
    """How many stretches of so many rows are small."""
    return int(np.sum(np.lib.stride_tricks.sliding_window_view(small, length, axis=1).all(axis=2)))


def _is_at_one_value(measured: np.ndarray, runs: np.ndarray) -> bool:
    """Whether runs, long or short, hold one value, or either end of the range, as often as a dead band or limits do."""
    values = measured[runs[:, 0], runs[:, 1]]
    at_ends = int(np.sum((values == measured.max()) | (values == measured.min())))
    most = int(np.unique(values, return_counts=True)[1].max())
    return max(at_ends, most) > max(2, AT_ONE_VALUE * len(values))


def runs_of(same: np.ndarray) -> np.ndarray:
    """(K, 3) repeat, first step and number of steps of every run."""
    edges = np.diff(np.pad(same.astype(int), ((0, 0), (1, 1))), axis=1)
    first, end = np.argwhere(edges > 0), np.argwhere(edges < 0)
    return np.column_stack([first, end[:, 1] - first[:, 1]])
