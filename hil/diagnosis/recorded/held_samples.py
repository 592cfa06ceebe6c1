"""Samples that were held before the sensor's noise came on top: readings stay where the channel was while the other repeats move on.

A held reading does not repeat the last one exactly, so it is looked for by its likelihood. Rows i to i + L - 1 of a burst have the mean
s_(i-1) in place of s_k, s being what the other repeats read there; everything else is the noise that repeats differ by, autoregressive and
as strong as it is around the burst. The likelihood ratio of all ways to place bursts, over none, has the expectation one where nothing is
held, so that it exceeds 1 / alpha with a probability of at most alpha (Markov's inequality; there is no number of tries to count). That
holds as far as the noise's distribution does; bursts turned round, readings that run ahead of the others, show how far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.linalg
import scipy.ndimage
import scipy.signal
import scipy.stats

LEAST_REPEATS = 3
"""Of two repeats, either may be the one that is held."""

ORDER = 6
"""Of the autoregression of what repeats differ by."""

LONGEST = 12
"""Rows of a burst; a longer one is several."""

SMOOTHED = 5
"""Rows of the parabola that the other repeats are smoothed with."""

AROUND = 41
"""Rows whose median says how strong the noise is around a burst: near reversals it may be many times what it is elsewhere."""

LEAST_DISTANCE = 5.0
"""Standard deviations by which a burst must stand out of the noise; of the others nothing is asked, and the smoothed repeats' own noise
makes none of them."""

CLIPPED = 3.0
"""Differences are clipped to this many standard deviations where the noise is estimated: bursts are none of it."""

TRIED = tuple(product((0.0003, 0.001, 0.003, 0.01, 0.03, 0.1), (0.9, 1.0 / 3.0, 0.1)))
"""Probabilities per row of a burst's beginning and of its end."""

LEAST_EVIDENCE = 60.0
"""Logarithm of the likelihood ratio. Were the noise as assumed, 7 would do for one in a thousand; disturbances that begin and end at
reversals have brought it to 40 where nothing is held, and once, in 152 drawn machines, to 85."""

TURNED_ROUND = 1.3
"""The logarithm must exceed this many times that of the bursts turned round."""

RUN_BACKWARDS = 1.1
"""And this many times that of the recordings run backwards in time: what comes later in one repeat, a disturbance or the end of sticking,
looks held both ways."""

STAYS = (0.85, 1.15)
STAYS_AT_MOST = 1.4
"""What bursts stay behind, as a share of what the others move on meanwhile, is one where readings are held: bounds of the median, of the
mean weighted by energy, and of the ninth tenth. Drawn with held samples it is 0.87 to 1.04, 0.88 to 1.05 and 1.30 at most; drawn without,
with disturbances that the repeats do not share or sticking that ends at other times in each, one of the three is outside, or the recordings
run backwards are as likely."""

LEAST_EQUAL = 3
"""Readings of a burst that are the same where noise changes every one. Two lost ones after one at a motion's turn are too few: the noise of
that one reading may be most of what the others moved on."""

BY_ITSELF = 1e-3
"""Probability with which bursts that come at any time are as close together as these: a motion's beginning that differs between repeats has
several, such as five in four repeats within 40 rows of 2560. Losses that come in storms are refused with them."""

PROMISING = 12.0
"""Logarithm of the likelihood ratio of the clearest burst, below which all ways to place bursts are not added up."""


@dataclass(frozen=True, eq=False)
class Held:
    """Rows of repeats that were held.

    `rows` (R, N) says which; `share` of all rows and its 95 % interval, mean `length` of a burst, and the logarithm of the likelihood
    ratio, `evidence`.
    """

    rows: np.ndarray
    share: float
    ci95: tuple[float, float]
    length: float
    evidence: float


def held_samples(measured: np.ndarray, *, is_never_still: bool = False) -> Held | None:
    """Look for held samples of one channel.

    Parameters
    ----------
    measured : (R, N) array
        Repeats.
    is_never_still : bool
        Whether noise changes every reading. Then bursts of one reading, three times or more, stay where they are, be it not where the
        others were: the noise in that reading stays with it.

    Returns
    -------
    Held or None
        None where nothing is held, samples are missing, or fewer than three repeats are there.
    """
    repeats, rows = measured.shape
    if repeats < LEAST_REPEATS or rows < AROUND + LONGEST or not np.isfinite(measured).all():
        return None
    bursts = _bursts(measured)
    if bursts is None:
        return None
    ratios = bursts.logarithms(1.0)
    if ratios.max() < PROMISING:
        return None
    placed = _placed(ratios)
    evidence = float(placed.max())
    if evidence < LEAST_EVIDENCE or evidence < TURNED_ROUND * _placed(bursts.logarithms(-1.0)).max():
        return None
    backwards = _bursts(measured[:, ::-1])
    if backwards is not None and evidence < RUN_BACKWARDS * _placed(backwards.logarithms(1.0)).max():
        return None
    held = _likeliest(bursts, TRIED[int(np.argmax(placed))], evidence)
    stays = _stay(bursts, held.rows) or (is_never_still and _is_one_reading_each(measured, held.rows))
    return held if stays and not _close_together(bursts, held) else None


def _stay(bursts: _Bursts, rows: np.ndarray) -> bool:
    """Whether readings in these rows (R, N) stay where they were, and not somewhere behind."""
    along, energy = [], []
    edges = np.diff(np.pad(rows.astype(int), ((0, 0), (1, 1))), axis=1)
    for repeat, edge in enumerate(edges):
        for begin, end in zip(np.flatnonzero(edge > 0).tolist(), np.flatnonzero(edge < 0).tolist(), strict=True):
            for first in range(begin, end, LONGEST):
                if 1 <= first <= bursts.along.shape[1]:
                    place = repeat, first - 1, min(end - first, LONGEST) - 1
                    along.append(bursts.along[place])
                    energy.append(bursts.energy[place])
    if not along:
        return False
    shares = np.array(along) / np.maximum(energy, 1e-300)
    middle, mean = float(np.median(shares)), float(np.sum(along) / np.sum(energy))
    return STAYS[0] <= middle <= STAYS[1] and STAYS[0] <= mean <= STAYS[1] and float(np.percentile(shares, 90.0)) <= STAYS_AT_MOST


def _is_one_reading_each(measured: np.ndarray, rows: np.ndarray) -> bool:
    """Whether every run of these rows (R, N) reads the same all along, the shortest of them for LEAST_EQUAL rows."""
    edges = np.diff(np.pad(rows.astype(int), ((0, 0), (1, 1))), axis=1)
    begins, ends = np.argwhere(edges > 0), np.argwhere(edges < 0)
    runs = [measured[repeat, begin:end] for (repeat, begin), (_, end) in zip(begins.tolist(), ends.tolist(), strict=True)]
    return all(len(run) >= LEAST_EQUAL and bool(np.all(run == run[0])) for run in runs)


def _close_together(bursts: _Bursts, held: Held) -> bool:
    """Whether the bursts of all repeats come at one time, of all times at which they would show."""
    edges = np.diff(np.pad(held.rows.astype(int), ((0, 0), (1, 1))), axis=1)
    begins, ends = np.nonzero(edges > 0)[1], np.nonzero(edges < 0)[1]
    lengths = np.clip(ends - begins, 1, LONGEST) - 1
    shows = np.mean(bursts.energy[:, :, lengths] >= LEAST_DISTANCE**2, axis=2)
    before = np.concatenate([[0.0], np.cumsum(shows.sum(axis=0))]) / max(float(shows.sum()), 1.0)
    when = np.sort(before[np.clip(begins - 1, 0, len(before) - 1)])
    count, smallest = len(when), 1.0
    for more in range(1, count):
        within = float(np.min(when[more:] - when[:-more])) + 1.0 / max(float(shows.sum()), 1.0)
        smallest = min(smallest, count * float(scipy.stats.binom.sf(more - 1, count - 1, min(within, 1.0))))
    return count * smallest < BY_ITSELF


def _bursts(measured: np.ndarray) -> _Bursts | None:
    """Of every repeat (R, N) against the median of the others."""
    others = np.stack([np.median(np.delete(measured, r, axis=0), axis=0) for r in range(len(measured))])
    return _Bursts.of(measured - others, scipy.signal.savgol_filter(others, SMOOTHED, 2, axis=1))


@dataclass(frozen=True, eq=False)
class _Bursts:
    """Along (R, N - LONGEST, LONGEST) what the differences have of each burst, and `energy` of it, both in units of noise: of a burst that
    begins a row later than the index says and has one row more than its own index.
    """

    along: np.ndarray
    energy: np.ndarray

    @classmethod
    def of(cls, differences: np.ndarray, means: np.ndarray) -> _Bursts | None:
        """None where the repeats do not differ, or no burst stands out even of the noise of quiet times."""
        predictor = _predictor(differences)
        if predictor is None:
            return None
        innovations = scipy.signal.lfilter(predictor, [1.0], differences, axis=1)
        innovations[:, :ORDER] = 0.0
        back = scipy.signal.lfilter(predictor, [1.0], innovations[:, ::-1], axis=1)[:, ::-1]
        windows = np.lib.stride_tricks.sliding_window_view
        shifts = means[:, :-LONGEST, None] - windows(means[:, 1:], LONGEST, axis=1)
        along = np.cumsum(shifts * windows(back[:, 1:], LONGEST, axis=1), axis=2)
        products = np.correlate(predictor, predictor, "full")[ORDER:]
        between = scipy.linalg.toeplitz(np.pad(products, (0, LONGEST))[:LONGEST])
        energy = np.cumsum(shifts * (shifts * products[0] + 2.0 * shifts @ np.triu(between, 1)), axis=2)
        if np.max((along - 0.5 * energy)[energy >= LEAST_DISTANCE**2], initial=0.0) < PROMISING:
            return None
        power = _level(innovations)[:, 1 : 1 + along.shape[1], None] ** 2
        return cls(along / power, energy / power)

    def logarithms(self, way: float) -> np.ndarray:
        """(R, N - LONGEST, LONGEST) of every burst's likelihood ratio; -1: of the same, turned round."""
        return np.where(self.energy < LEAST_DISTANCE**2, 0.0, way * self.along - 0.5 * self.energy)


def _level(innovations: np.ndarray) -> np.ndarray:
    """(R, N) of how strong the noise is around, at least 1."""
    sizes = np.abs(innovations[:, ORDER:])  # before, nothing is predicted: zeros there would pass for a record that begins without noise
    inside = scipy.ndimage.median_filter(sizes, size=(1, AROUND), mode="reflect") / 0.6745
    around = np.pad(inside, ((0, 0), (ORDER, 0)), mode="edge")
    return np.maximum(scipy.ndimage.maximum_filter1d(around, LONGEST, axis=1), 1.0)


def _predictor(differences: np.ndarray) -> np.ndarray | None:
    """(ORDER + 1,) filter that makes the differences white and of unit variance; None where they are zero."""
    spread = float(np.median(np.abs(differences))) / 0.6745
    if spread == 0.0:
        return None
    clipped = np.clip(differences, -CLIPPED * spread, CLIPPED * spread)
    clipped -= clipped.mean(axis=1, keepdims=True)
    rows = clipped.shape[1]
    lags = np.array([np.mean(clipped[:, k:] * clipped[:, : rows - k]) for k in range(ORDER + 1)])
    lags[0] *= 1.0 + 1e-6
    predictor = np.concatenate([[1.0], scipy.linalg.solve_toeplitz(lags[:-1], -lags[1:])])
    innovations = scipy.signal.lfilter(predictor, [1.0], clipped, axis=1)[:, ORDER:]
    return predictor / float(innovations.std())


def _beforehand(tried: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of the probabilities, for each of those that were tried (T,), that no burst begins, and that one of each length (L, T)."""
    enter, leave = np.array(tried).T
    lengths = (1.0 - leave) ** np.arange(LONGEST)[:, None]
    return np.log1p(-enter), np.log(enter * lengths / lengths.sum(axis=0))


def _placed(ratios: np.ndarray) -> np.ndarray:
    """(T,) logarithm of the likelihood ratio of all ways to place bursts, of all repeats, for each of the probabilities in TRIED."""
    none, burst = _beforehand(TRIED)
    repeats, rows, _ = ratios.shape
    total = np.full((rows + LONGEST + 1, len(TRIED), repeats), -np.inf)
    total[0] = 0.0
    for row in range(rows):
        total[row + 1] = np.logaddexp(total[row + 1], total[row] + none[:, None])
        after = total[row + 1 : row + 1 + LONGEST]
        np.logaddexp(after, total[row] + ratios[:, row].T[:, None, :] + burst[:, :, None], out=after)
    return total[rows].sum(axis=1)


def _likeliest(bursts: _Bursts, tried: tuple[float, float], evidence: float) -> Held:
    """Rows and shares at these probabilities."""
    rows = _most_probable(bursts.logarithms(1.0), tried)
    begins = max(int(np.sum(rows[:, 1:] & ~rows[:, :-1])), 1)
    length = float(rows.sum()) / begins
    seen = bursts.energy[:, :, min(max(round(length), 1), LONGEST) - 1] >= LEAST_DISTANCE**2
    # those that come where they would show; their number scatters as Poisson's
    rates = np.array(scipy.stats.chi2.ppf([0.025, 0.975], [2 * begins, 2 * begins + 2])) / 2.0
    low, share, high = (rate * length / (seen.sum() + rate * length) for rate in (rates[0], begins, rates[1]))
    return Held(rows, share, (low, high), length, evidence)


def _most_probable(ratios: np.ndarray, tried: tuple[float, float]) -> np.ndarray:
    """(R, N) rows of the likeliest bursts (Viterbi)."""
    none, lengths = _beforehand([tried])
    repeats, rows, _ = ratios.shape
    best = np.full((rows + LONGEST + 1, repeats), -np.inf)
    best[0] = 0.0
    came_by = np.zeros((rows + LONGEST + 1, repeats), dtype=int)  # rows of the burst that ends here
    for row in range(rows):
        stay = best[row] + none
        better = stay > best[row + 1]
        best[row + 1] = np.where(better, stay, best[row + 1])
        came_by[row + 1] = np.where(better, 0, came_by[row + 1])
        burst = best[row] + ratios[:, row].T + lengths
        after = slice(row + 1, row + 1 + LONGEST)
        better = burst > best[after]
        best[after] = np.where(better, burst, best[after])
        came_by[after] = np.where(better, np.arange(1, LONGEST + 1)[:, None], came_by[after])
    held = np.zeros((repeats, rows + LONGEST), dtype=bool)
    for repeat in range(repeats):
        row = rows
        while row > 0:
            length = came_by[row, repeat]
            held[repeat, row - length + 1 : row + 1] = length > 0
            row -= max(length, 1)
    return held
