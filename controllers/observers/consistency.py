"""Consistency of a filter: normalised innovations squared (NIS) against chi-square, and what corrects the published values against theirs.

Innovations that are not white say that something acts which the model lacks; what is published may be right all the same. In a consistent
filter the corrections G K ν of published values G x are white, with the covariance G K S Kᵀ Gᵀ by which the sample narrows their variance
(Kailath 1968). So their sum over a while is as large as the stated variances say, and where it is larger, these are false.

What pulls an estimate in a direction that the sensors hardly see corrects it by little for long: no sum of corrections shows that. Where
the design was held to drawn machines, it knows how large the mean innovations of sound ones become, the part that is wrong in them
included, and the alarm looks at these means instead, over a short time for a jump and over longer ones for what stays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import signal, stats

from controllers.compiled import exactly_compiled

WINDOW = 64
"""Samples over which NIS is averaged, and in which a correction is forgotten to 1/e: a quarter of a second at 256 Hz."""

FALSE_ALARM = 1e-6
"""Probability that one sample's sum of corrections of one point or angle raises the alarm by chance: of three at 256 Hz once in twenty
minutes if samples were independent, less often as they are not."""

WINDOWS_s = (0.25, 1.0, 4.0)
"""In which an innovation is forgotten to 1/e: a shock, what has to be told within a second, and half a scan. Four times one another, so
that whatever lasts some time between is seen at no less than 0.9 of what its own window would show."""

LASTING = 2.0
"""Windows that an alarm of a passing push may last, and for which a silent channel's mean still counts: as long as it takes to be
forgotten. The weight of what was seen is then e^-4, its share in a mean e^-2."""

GROUPS = ((0, 3), (3, 6), (6, 9))
"""Among the geometric parameters: focal spot, isocentre, orientation."""


class Innovations(NamedTuple):
    """The last samples' normalised innovations squared, in the order of a ring."""

    nis: np.ndarray  # (window,)
    measured: np.ndarray  # (window,)
    place: np.ndarray  # (1,) int: of the next sample


class Corrections(NamedTuple):
    """Sums over the past of the geometric parameters' corrections, of which a sample keeps a share."""

    total: np.ndarray  # (9,)
    variance: np.ndarray  # (9,)
    kept: float
    most: float  # squared norm of a point's or angles' total over its variance that raises the alarm
    sums: np.ndarray  # (windows, measurements) of whitened innovations; no window where it is not known what is usual
    weights: np.ndarray  # (windows, measurements) variances that these have where innovations are white
    forgets: np.ndarray  # (windows,) as `kept`
    usual: np.ndarray  # (windows, measurements) `ObserverNoise.usual`
    silent: np.ndarray  # (measurements,) int: rows since each was measured
    passes: np.ndarray  # (windows or 1,) rows of `LASTING` windows
    lasts: np.ndarray  # (windows or 1,) int: rows since which each has raised the alarm


@exactly_compiled
def mean_innovation(recent: Innovations, nis: float, measured: float) -> float:
    """Take a sample in; return the mean NIS per measurement over the window: 1 when consistent, NaN without a measurement."""
    place = recent.place[0]
    recent.nis[place] = nis
    recent.measured[place] = measured
    recent.place[0] = (place + 1) % len(recent.nis)
    freedom, sums = 0.0, np.zeros(8)  # eight sums side by side, as NumPy adds
    for k in range(len(recent.nis)):
        freedom += recent.measured[k]
        sums[k % 8] += recent.nis[k]
    total = ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
    return total / freedom if freedom > 0.0 else math.nan


@exactly_compiled
def corrects_too_much(recent: Corrections, correction: np.ndarray, variance: np.ndarray) -> bool:
    """Take a sample's correction (9,) in, and its variance (9,); tell whether it and those before are too large for chance."""
    for g in range(9):
        recent.total[g] = recent.total[g] * recent.kept + correction[g]
        recent.variance[g] = recent.variance[g] * recent.kept**2 + variance[g]
    raised = False
    for low, high in GROUPS:
        size, spread = 0.0, 0.0
        for g in range(low, high):
            size += recent.total[g] * recent.total[g]
            spread += recent.variance[g]
        raised = raised or size > recent.most * spread
    recent.lasts[0] = recent.lasts[0] + 1 if raised else 0
    return raised


@exactly_compiled
def is_unusual(recent: Corrections, whitened: np.ndarray) -> bool:
    """Take a sample's whitened innovations (measurements,) in; tell whether a mean of them and of those before leaves what is usual.

    Sums and weights of a silent channel fade alike, so that its mean would stand for ever: it is forgotten after `LASTING` windows.
    """
    raised = False
    for j in range(len(whitened)):
        recent.silent[j] = 0 if whitened[j] == whitened[j] else recent.silent[j] + 1
    for w in range(len(recent.forgets)):
        kept, size = recent.forgets[w], 0.0
        for j in range(len(whitened)):
            total, weight = recent.sums[w, j] * kept, recent.weights[w, j] * kept**2
            if whitened[j] == whitened[j]:
                total += whitened[j]
                weight += 1.0
            if recent.silent[j] > recent.passes[w]:
                total, weight = 0.0, 0.0
            recent.sums[w, j], recent.weights[w, j] = total, weight
            if weight > 0.0:
                size += total * total / (weight * recent.usual[w, j])
        recent.lasts[w] = recent.lasts[w] + 1 if size > 1.0 else 0
        raised = raised or size > 1.0
    return raised


def means(whitened: np.ndarray, rate_Hz: float) -> np.ndarray:
    """Return the means (N, windows, measurements) of whitened innovations (N, measurements) that `is_unusual` looks at."""
    known, rows = np.isfinite(whitened), np.arange(1, 1 + len(whitened))[:, None]
    silent = rows - np.maximum.accumulate(np.where(known, rows, 0))
    found = np.zeros((len(whitened), len(WINDOWS_s), whitened.shape[1]))
    for w, window in enumerate(rate_Hz * np.array(WINDOWS_s)):
        kept = np.exp(-1.0 / window)
        forgotten = np.maximum.accumulate(np.where(silent > LASTING * window, rows, 0))  # the last row by which nothing was left
        total = _since(forgotten, signal.lfilter([1.0], [1.0, -kept], np.where(known, whitened, 0.0), axis=0), kept)
        weight = _since(forgotten, signal.lfilter([1.0], [1.0, -(kept**2)], known.astype(float), axis=0), kept**2)
        found[:, w] = np.divide(total, np.sqrt(weight), out=np.zeros_like(total), where=weight > 0.0)
    return found


def _since(forgotten: np.ndarray, fading: np.ndarray, kept: float) -> np.ndarray:
    """Return fading sums (N, measurements) of what came after a row (N, measurements), which counts from 1; 0: of all."""
    rows = np.arange(1, 1 + len(fading))[:, None]
    before = np.take_along_axis(np.vstack((np.zeros(fading.shape[1]), fading)), forgotten, axis=0)
    left: np.ndarray = fading - kept ** (rows - forgotten) * before
    return left


class InnovationMonitor:
    """Averages normalised innovations squared over the last `WINDOW` samples. Allocates nothing while it runs."""

    def __init__(self, window: int = WINDOW) -> None:
        self.recent = Innovations(np.zeros(window), np.zeros(window), np.zeros(1, dtype=np.int64))

    def reset(self) -> None:
        """Forget all samples."""
        for values in self.recent:
            values[:] = 0

    def step(self, nis: float, measured: float) -> float:
        """Return the mean NIS per measurement over the window: 1 when consistent, NaN without a measurement."""
        return mean_innovation(self.recent, float(nis), float(measured))


class CorrectionMonitor:
    """Compares recent innovations with what is usual, or where that is not known corrections of geometric parameters with their variances.

    The squared norm of a point's correction is a weighted sum of chi-squares; far out it is largest where one direction has all the weight.
    """

    def __init__(
        self, window: float = WINDOW, false_alarm: float = FALSE_ALARM, usual: np.ndarray | None = None, rate_Hz: float = 1.0
    ) -> None:
        most = float(stats.norm.isf(0.5 * false_alarm)) ** 2
        limits = np.zeros((0, 0)) if usual is None else np.array(usual, float)
        forgets = np.exp(-1.0 / (rate_Hz * np.array(WINDOWS_s[: len(limits)])))
        rows = rate_Hz * np.array(WINDOWS_s) if len(limits) else np.array([window])
        silent, lasts = (np.zeros(count, dtype=np.int64) for count in (limits.shape[1], len(rows)))
        bank = np.zeros(limits.shape), np.zeros(limits.shape), forgets, limits, silent, LASTING * rows, lasts
        self.recent = Corrections(np.zeros(9), np.zeros(9), math.exp(-1.0 / window), most, *bank)

    def reset(self) -> None:
        """Forget all samples."""
        recent = self.recent
        for values in (recent.total, recent.variance, recent.sums, recent.weights, recent.silent, recent.lasts):
            values[:] = 0

    @property
    def is_lasting(self) -> bool:
        """Whether an alarm outlasts its window by far: a passing one is a push, a lasting one means that the model is wrong."""
        return any(rows > passes for rows, passes in zip(self.recent.lasts.tolist(), self.recent.passes.tolist(), strict=True))

    def step(self, correction: np.ndarray, variance: np.ndarray) -> bool:
        """Tell whether a sample's correction (9,), with its variance (9,), and those before are too large for chance."""
        return corrects_too_much(self.recent, correction, variance)


def share_in_band(nis: np.ndarray, measured: np.ndarray, probability: float = 0.95) -> float:
    """Return the share of samples whose NIS lies in chi-square's central band; rows without a measurement do not count.

    Parameters
    ----------
    nis, measured : (N,) arrays
    """
    known = measured > 0
    tail = 0.5 * (1.0 - probability)
    low, high = stats.chi2.ppf(tail, measured[known]), stats.chi2.ppf(1.0 - tail, measured[known])
    return float(np.mean((nis[known] >= low) & (nis[known] <= high)))
