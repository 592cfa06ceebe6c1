"""Lost samples of a channel that noise never leaves still: the same reading several times in a row.

Where white noise of many counts changes every reading, two in a row are the same once in a hundred rows or so, and five never. This asks
for no motion, where `dropout.without_lost_samples` does, and sees losses that are few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import scipy.stats

AROUND = 65
"""Rows whose third differences say how strong the noise is; half of them may be lost."""

SAME = 0.4 / np.sqrt(2.0)
"""Density at zero of the difference of two readings, times the rms of their white noise: 1 / (2 sqrt(pi)). With noise that is slower than
white, third differences are smaller than its rms and repeats are thought commoner than they are."""

SAFETY = 2.0
"""Factor on the probability that a reading repeats by itself."""

LARGEST_CHANCE = 0.2
"""Probability of a repeat, safety in it, above which a row says nothing: noise of three counts."""

LONGEST = 8
"""Repeats in a row that are asked for at most."""


@dataclass(frozen=True, eq=False)
class Repeated:
    """Readings that repeat the one before more often in a row than noise lets them.

    Attributes
    ----------
    rows : (R, N) bool array
        Readings that are lost for certain: in runs so long that chance makes fewer than one.
    runs : int
        Such runs.
    least : int
        Repeats in a row in each of them, or more.
    share : float
        Of all rows, that are lost.
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
        None where nothing is lost so, or noise is too small to tell.
    """
    steps = np.diff(measured, axis=1)
    moved = np.abs(steps[steps != 0.0])
    if measured.shape[1] < AROUND or not moved.size or not np.isfinite(measured).all():
        return None
    chance = SAFETY * _chance(measured, float(moved.min()))
    at_an_end = (measured[:, 1:] == measured.max()) | (measured[:, 1:] == measured.min())  # a drive at its limit repeats itself
    runs = _runs((steps == 0.0) & (chance <= LARGEST_CHANCE) & ~at_an_end)
    chance = chance[chance <= LARGEST_CHANCE]
    if not runs.size or not chance.size:
        return None
    by_chance = np.array([np.sum(chance**k) for k in range(1, LONGEST + 1)])  # runs of so many repeats or more
    seen = np.array([np.sum(runs[:, 2] >= k) for k in range(1, LONGEST + 1)])
    unlikely = (LONGEST - 1) * float(np.min(scipy.stats.poisson.sf(seen[1:] - 1, by_chance[1:])))
    if unlikely > largest_chance:
        return None
    return _losses(runs, 1 + int(np.sum(by_chance >= 1.0)), float(chance.sum() / SAFETY), measured.shape)


def _losses(runs: np.ndarray, least: int, by_chance: float, shape: tuple[int, ...]) -> Repeated:
    """Runs of `least` repeats or more are losses; of the others all but those that come by chance."""
    long = runs[runs[:, 2] >= least]
    rows = np.zeros(shape, dtype=bool)
    for repeat, first, length in long.tolist():
        rows[repeat, first + 1 : first + 1 + length] = True
    length = float(np.mean(long[:, 2] - least + 1.0))  # bursts that last go on as if they had just begun
    lost = max(float(runs[:, 2].sum()) - by_chance, float(long[:, 2].sum()))
    bursts = max(lost / length, 1.0)
    # the number of bursts scatters as Poisson's, and their lengths by as much again
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], [bursts, bursts + 2.0]) / bursts
    share = lost / rows.size
    return Repeated(rows, len(long), least, share, (float(low * share), float(min(high * share, 1.0))), length)


def _chance(measured: np.ndarray, lattice: float) -> np.ndarray:
    """(R, N - 1) probability of a repeat by the noise around."""
    third = np.abs(np.diff(measured, n=3, axis=1))
    around = scipy.ndimage.median_filter(third, size=(1, AROUND), mode="reflect") / 0.6745 / np.sqrt(20.0)
    around = np.pad(around, ((0, 0), (1, 1)), mode="edge")
    return SAME * lattice / np.maximum(around, 1e-12 * lattice)


def _runs(same: np.ndarray) -> np.ndarray:
    """(K, 3) repeat, first step and number of steps of every run."""
    edges = np.diff(np.pad(same.astype(int), ((0, 0), (1, 1))), axis=1)
    first, end = np.argwhere(edges > 0), np.argwhere(edges < 0)
    return np.column_stack([first, end[:, 1] - first[:, 1]])
