"""From the times of some thousand ticks: their percentiles, and the ticks that ten minutes will lose, with an interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gamma
from scipy.stats import beta, genextreme, t

HORIZON_S = 600.0
BLOCK_S = 0.25
"""Length of a block, of which the longest tick counts: stalls of a host last some ticks, so that those of two blocks are independent."""
LEAST_BLOCKS = 8
CONFIDENCE = 0.9
RESAMPLED = 400
WINDOWS = 8
"""Equal parts of a trial, whose differences tell how a computer's punctuality wanders."""
LOST_AT_ONCE = 1000
"""Ticks lost in one stall up to which an extrapolation is summed."""


@dataclass(frozen=True)
class Prediction:
    """What to expect of a loop, from a trial.

    `expected_missed` extrapolates block maxima with a generalised extreme-value distribution. The intervals do not rest on it. They are for
    what the `HORIZON_S` after the trial will show, nine times of ten if the computer goes on as in the trial. Load, other guests of a host
    and its clock change over minutes, so that ten minutes differ from a trial by more than chance: see `wandering`. What did not
    happen in the trial is allowed for as far as chance may have hidden it, no further. `p999_least_s` to `p999_most_s` is the interval of
    the 99.9th percentile. `least_missed` to `most_missed` is the binomial interval (Clopper and Pearson 1934) of the share of blocks with a
    lost tick, widened by `_dispersion`, times the ticks that such a block loses.
    """

    ticks: int
    period_s: float
    p50_s: float
    p99_s: float
    p999_s: float
    p999_least_s: float
    p999_most_s: float
    max_s: float
    missed_in_trial: int
    expected_missed: float  # per HORIZON_S
    least_missed: float
    most_missed: float


def missed_ticks(tick_s: np.ndarray, period_s: float) -> np.ndarray:
    """Return how many ticks are lost after each: a period or more must be lost when the loop begins to wait for the next.

    Parameters
    ----------
    tick_s : (n,) array
        From when each tick was due until the loop was ready to wait again [s].
    period_s : float
    """
    lost: np.ndarray = np.maximum(np.floor(tick_s / period_s).astype(int) - 1, 0)
    return lost


def predict(tick_s: np.ndarray, period_s: float) -> Prediction:
    """Predict from the times of consecutive ticks.

    Parameters
    ----------
    tick_s : (n,) array
        See `missed_ticks`.
    period_s : float

    Raises
    ------
    ValueError
        There are fewer ticks than `LEAST_BLOCKS` blocks.
    """
    rows = max(round(BLOCK_S / period_s), 1)
    blocks = len(tick_s) // rows
    if blocks < LEAST_BLOCKS:
        raise ValueError(f"{len(tick_s)} ticks: at least {LEAST_BLOCKS * rows} are needed for {LEAST_BLOCKS} blocks of {BLOCK_S:g} s")
    used = tick_s[len(tick_s) - blocks * rows :].reshape(blocks, rows)
    lost = missed_ticks(used, period_s).sum(axis=1)
    is_bad = lost > 0
    bad = int(np.count_nonzero(is_bad))
    in_horizon = HORIZON_S / (rows * period_s)
    each = float(lost.sum()) / bad if bad else 1.0
    miss = 0.5 * (1.0 - CONFIDENCE)
    scale = 1.0 / _dispersion(is_bad, in_horizon / blocks)
    low = float(beta.ppf(miss, scale * bad, scale * (blocks - bad) + 1)) if bad else 0.0
    high = float(beta.ppf(1.0 - miss, scale * bad + 1, scale * (blocks - bad))) if bad < blocks else 1.0
    p50, p99, p999 = np.percentile(tick_s, [50.0, 99.0, 99.9]).tolist()
    longest = used.max(axis=1)
    levels = np.array([np.log(part).mean() for part in np.array_split(longest, WINDOWS)])
    wander = t.ppf(0.5 * (1.0 + CONFIDENCE), WINDOWS - 2) * np.sqrt(wandering(levels, in_horizon / blocks))
    by_chance = np.sqrt(1.0 + blocks / in_horizon)  # of the trial, and of the horizon itself
    below, above = (float(np.hypot(by_chance * np.log(end / p999), wander)) for end in _p999_interval(used))
    return Prediction(
        len(tick_s),
        period_s,
        *(p50, p99, p999, p999 * np.exp(-below), p999 * np.exp(above), float(tick_s.max())),
        int(missed_ticks(tick_s, period_s).sum()),
        in_horizon * _lost_per_block(longest, period_s),
        in_horizon * low * each,
        in_horizon * high * each,
    )


def wandering(windows: np.ndarray, horizon: float) -> float:
    """Return the variance of the mean over a horizon less that over the windows before it, for a level that wanders.

    A level with a spectrum of 1/f has no mean to which it returns, and its adjacent windows differ by the same, however long they are
    (Allan 1966). From its covariance -c ln|t|, with the means I(A, B) of ln|s - t| over windows and horizon, the difference of both has the
    variance c (2 I(A, B) - I(A, A) - I(B, B)); that of adjacent equal windows is 4 c ln 2.

    Parameters
    ----------
    windows : (n,) array
        Level of each.
    horizon : float
        Length of the horizon over that of all windows.
    """

    def double(length: float) -> float:
        return float(length**2 * (np.log(length) - 1.5))

    across = (double(1.0 + horizon) - double(1.0) - double(horizon)) / (2.0 * horizon)
    share = (2.0 * across + 3.0 - np.log(horizon)) / (4.0 * np.log(2.0))
    return float(share * np.mean(np.diff(windows) ** 2))


def _dispersion(is_bad: np.ndarray, horizon: float) -> float:
    """Return how many times a trial's binomial variance the share of bad blocks of the horizon has about the trial's, at least 1.

    The horizon adds its own, which is smaller as it is longer. What the windows of the trial differ by beyond chance is wandering
    (quasi-likelihood: McCullagh and Nelder 1989, section 4.5).
    """
    shares = np.array([part.mean() for part in np.array_split(is_bad, WINDOWS)])
    chance = max(is_bad.mean() * (1.0 - is_bad.mean()), np.finfo(float).tiny) / len(is_bad)
    by_chance = 2.0 * WINDOWS * chance  # mean squared difference of adjacent windows
    beyond = max(0.0, float(np.mean(np.diff(shares) ** 2)) / by_chance - 1.0)
    return float(1.0 + 1.0 / horizon + beyond * wandering(np.array([0.0, np.sqrt(by_chance)]), horizon) / chance)


def _p999_interval(blocks: np.ndarray) -> tuple[float, float]:
    """Return the interval of the 99.9th percentile, with `CONFIDENCE`, from blocks (n, rows) that do not depend on each other."""
    drawn = np.random.default_rng(0).integers(0, len(blocks), (RESAMPLED, len(blocks)))
    found = [np.percentile(blocks[rows], 99.9) for rows in drawn]
    low, high = np.quantile(found, [0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)]).tolist()
    return low, high


def extreme_value_distribution(maxima: np.ndarray) -> tuple[float, float, float]:
    """Fit shape, location and scale of the generalised extreme-value distribution, SciPy's signs, by probability-weighted moments.

    Source: Hosking, Wallis, Wood 1985, eqs. (14) and (15).
    """
    x = np.sort(maxima)
    n, j = len(x), np.arange(len(x))
    b0, b1, b2 = x.mean(), (j * x).sum() / (n * (n - 1)), (j * (j - 1) * x).sum() / (n * (n - 1) * (n - 2))
    second, third = 2 * b1 - b0, 6 * b2 - 6 * b1 + b0
    if second <= 0.0:
        return 0.0, float(b0), 0.0
    c = 2.0 / (3.0 + third / second) - np.log(2.0) / np.log(3.0)
    shape = 7.8590 * c + 2.9554 * c**2
    if abs(shape) < 1e-6:
        scale = second / np.log(2.0)
        return 0.0, float(b0 - np.euler_gamma * scale), float(scale)
    scale = second * shape / ((1.0 - 2.0**-shape) * gamma(1.0 + shape))
    return float(shape), float(b0 - scale * (1.0 - gamma(1.0 + shape)) / shape), float(scale)


def _lost_per_block(maxima: np.ndarray, period_s: float) -> float:
    """Return the expected number of ticks lost in a block."""
    shape, location, scale = extreme_value_distribution(maxima)
    if scale <= 0.0:
        return float(missed_ticks(maxima, period_s).mean())
    return float(genextreme.sf(period_s * np.arange(2, LOST_AT_ONCE), shape, location, scale).sum())
