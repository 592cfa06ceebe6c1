"""What a machine does over half a second, as smooth means, and how far it is from what its machine file makes of the same motion.

A mean with a weight w(t) that begins and ends at rest turns the equation of motion into one of means: those of position x, speed and
acceleration are the integrals of w x, -w' x and w'' x, so no reading is differentiated. The weight is a Hann window: vibrations above 4 Hz,
of joints that no encoder follows, leave nothing in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from math import isfinite, isnan, nan, sqrt

import numpy as np
from numba.extending import register_jitable

from drivers.interface import Sample
from drivers.judging.motion_means import DEVIATION, EFFORT, ORDERS, ROWS, Expected, Expects, Means
from drivers.sample_memory import imus_in, values_in

WINDOW_S = 0.5
"""Time over which means are taken: two periods of the slowest vibration, and short against a run."""

Average = Callable[[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray], None]
"""`average`, or the same compiled."""


@register_jitable
def average(samples: np.ndarray, weights: np.ndarray, period_s: float, means: np.ndarray, imu: np.ndarray) -> None:
    """Write the means of a window; an axis whose readings are missing has none, and a link without an encoder those of its motor side.

    Parameters
    ----------
    samples : array of bytes
        The memories of a window's samples, one after the other.
    weights : (ORDERS, ticks) array
        Of the mean, of its first and of its second derivative.
    period_s : float
    means : (ROWS, axes) array
        Overwritten, see `Means`.
    imu : (7,) array
        Overwritten by sums of the first IMU's channels [m/s^2, rad/s], and behind them the sum of their weights.
    """
    ticks, axes = weights.shape[1], means.shape[1]
    size = len(samples) // ticks
    means[:] = 0.0
    imu[:] = 0.0
    for k in range(ticks):
        memory = samples[k * size : (k + 1) * size]
        values, readings, is_whole = values_in(memory), imus_in(memory), True
        for axis in range(axes):
            position, link = values[axis].position, values[axis].link_position
            for order in range(ORDERS):
                means[2 * order, axis] += weights[order, k] * position
                means[2 * order + 1, axis] += weights[order, k] * link
            means[EFFORT, axis] += weights[0, k] * values[axis].effort
        for channel in range(6):
            is_whole = is_whole and isfinite(readings[channel])
        if is_whole:
            for channel in range(6):
                imu[channel] += weights[0, k] * readings[channel]
            imu[6] += weights[0, k]
    for axis in range(axes):
        for order in range(ORDERS):
            if isnan(means[2 * order + 1, axis]):
                means[2 * order + 1, axis] = means[2 * order, axis]
        mean, total = 0.0, 0.0
        for is_about in (False, True):  # the mean speed, then the deviation about it
            before = values_in(samples[:size])[axis].position
            for k in range(1, ticks):
                position = values_in(samples[k * size : (k + 1) * size])[axis].position
                speed = (position - before) / period_s
                before = position
                if is_about:
                    total += weights[0, k] * (speed - mean) ** 2
                else:
                    mean += weights[0, k] * speed
        means[DEVIATION, axis] = sqrt(total)


class MotionWindow:
    """Compares window after window of a machine's motion with what is expected of it.

    Parameters
    ----------
    expects : Expects
    axes : int
    period_s : float
        Between ticks.
    average : Average
        A compiled one takes less time.

    Attributes
    ----------
    over : bool
        Whether the newest sample ended a window.
    ticks : int
        Of a window.
    effort_off, effort_unsure : (axes,) array
        Mean effort less what was expected, and how unsure that is [drive's unit]; NaN before the first window.
    imu_off : (6,) array
        The same of the IMU's channels [m/s^2, rad/s].
    """

    def __init__(self, expects: Expects, axes: int, period_s: float, average: Average = average) -> None:
        self._expects, self._average, self._axes, self._period_s = expects, average, axes, period_s
        self.ticks = max(8, round(WINDOW_S / period_s))
        turn = 2.0 * math.pi / self.ticks
        phase = turn * (np.arange(self.ticks) + 0.5)
        rate = turn / period_s
        weight = 0.5 * (1.0 - np.cos(phase))
        self._weights = np.stack((weight, -0.5 * rate * np.sin(phase), 0.5 * rate**2 * np.cos(phase))) / weight.sum()
        self._samples = np.zeros((self.ticks, len(Sample(axes).memory)), np.uint8)
        self._in_order = self._samples.reshape(-1)
        self._means, self._imu = np.zeros((ROWS, axes)), np.zeros(7)
        self.begin()

    def begin(self) -> None:
        """Begin anew: nothing is known."""
        self.over = False
        self.effort_off = np.full(self._axes, nan)
        self.effort_unsure = np.full(self._axes, nan)
        self.imu_off = np.full(6, nan)
        self._tick = 0
        self._is_rehearsed = False  # since the newest sample

    def step(self, sample: Sample, ticks: int) -> None:
        """Take the newest sample; `ticks` passed since the one before. Lost ticks begin the window anew."""
        k = self._tick if ticks == 1 else 0
        self._samples[k] = sample.memory
        self._is_rehearsed = False
        is_full = k + 1 == self.ticks
        self._tick = 0 if is_full else k + 1
        self.over = is_full and self._compare()

    def rehearse(self) -> bool:
        """Compare what is there, without consequence and once, where the next sample ends a window; return whether it did so."""
        if not self.is_to_rehearse:
            return False
        self._is_rehearsed = True
        self._expected()
        return True

    @property
    def is_to_rehearse(self) -> bool:
        """Whether the next sample ends a window, and that has not been rehearsed."""
        return self._tick == self.ticks - 1 and not self._is_rehearsed

    def _expected(self) -> tuple[Means, Expected] | None:
        """Return the means of the window and what is expected of them; None where readings of its axes are missing."""
        self._average(self._in_order, self._weights, self._period_s, self._means, self._imu)
        if not isfinite(self._means.sum()):
            return None
        means = Means(self._means.copy())
        return means, self._expects(means)

    def _compare(self) -> bool:
        """Compare the window that is full; return False where readings of its axes are missing."""
        if (found := self._expected()) is None:
            return False
        means, expected = found
        self.effort_off = means.effort - expected.effort
        self.effort_unsure = expected.unsure
        if self._imu[6] > 0.5 and expected.imu.size:  # half of the readings: the mean is still that of the window
            self.imu_off = self._imu[:6] / self._imu[6] - expected.imu
        return True
