"""What a machine does over half a second, as smooth means, and how far it is from what its machine file makes of the same motion.

A mean with a weight w(t) that begins and ends at rest turns the equation of motion into one of means: those of position x, speed and
acceleration are the integrals of w x, -w' x and w'' x, so no reading is differentiated. The weight is a Hann window: vibrations above 4 Hz,
of joints that no encoder follows, leave nothing in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from math import nan

import numpy as np

from drivers.interface import IMUS_BYTES, VALUES, Sample

WINDOW_S = 0.5
"""Time over which means are taken: two periods of the slowest vibration, and short against a run."""


@dataclass(frozen=True)
class Expected:
    """What a machine file makes of a motion."""

    effort: np.ndarray  # (axes,) drive's unit, friction included
    unsure: np.ndarray  # (axes,) drive's unit: standard deviation, of friction without a known direction and of the load
    imu: np.ndarray  # (6,) m/s^2 and rad/s; empty without an IMU


@dataclass(frozen=True)
class Means:
    """Means over a window."""

    position: np.ndarray  # (2, axes) rad or m: motor side, link
    speed: np.ndarray  # (2, axes)
    acceleration: np.ndarray  # (2, axes)
    deviation: np.ndarray  # (axes,) of the motor side's speed about its mean
    effort: np.ndarray  # (axes,) drive's unit


Expects = Callable[[Means], Expected]


class MotionWindow:
    """Compares window after window of a machine's motion with what is expected of it.

    Parameters
    ----------
    expects : Expects
    axes : int
    period_s : float
        Between ticks.

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

    def __init__(self, expects: Expects, axes: int, period_s: float) -> None:
        self._expects, self._axes, self._period_s = expects, axes, period_s
        self.ticks = max(8, round(WINDOW_S / period_s))
        turn = 2.0 * math.pi / self.ticks
        phase = turn * (np.arange(self.ticks) + 0.5)
        rate = turn / period_s
        weight = 0.5 * (1.0 - np.cos(phase))
        self._weights = np.stack((weight, -0.5 * rate * np.sin(phase), 0.5 * rate**2 * np.cos(phase))) / weight.sum()
        self._samples = np.zeros((self.ticks, len(Sample(axes).memory)), np.uint8)
        self.begin()

    def begin(self) -> None:
        """Begin anew: nothing is known."""
        self.over = False
        self.effort_off = np.full(self._axes, nan)
        self.effort_unsure = np.full(self._axes, nan)
        self.imu_off = np.full(6, nan)
        self._tick = 0

    def step(self, sample: Sample, ticks: int) -> None:
        """Take the newest sample; `ticks` passed since the one before. Lost ticks begin the window anew."""
        k = self._tick if ticks == 1 else 0
        self._samples[k] = sample.memory
        is_full = k + 1 == self.ticks
        self._tick = 0 if is_full else k + 1
        self.over = is_full and self._compare()

    def _compare(self) -> bool:
        """Compare the window that is full; return False where readings of its axes are missing."""
        values, imu = self._samples[:, IMUS_BYTES:].view(VALUES), self._samples[:, :IMUS_BYTES].view(np.float64)[:, :6]
        # as whole arrays, since sums over parts of others are rounded in another order
        position, link, effort = (np.ascontiguousarray(values[each]) for each in ("position", "link_position", "effort"))
        effort = self._weights[0] @ effort
        motor = self._weights @ position  # position, speed, acceleration (3, axes)
        if not (np.isfinite(motor).all() and np.isfinite(effort).all()):
            return False
        link = self._weights @ link
        link = np.where(np.isnan(link), motor, link)
        between, speed = self._weights[0, 1:], np.diff(position, axis=0) / self._period_s
        deviation = np.sqrt(between @ (speed - between @ speed) ** 2)
        both = np.stack((motor, link), axis=1)
        expected = self._expects(Means(both[0], both[1], both[2], deviation, effort))
        self.effort_off = effort - expected.effort
        self.effort_unsure = expected.unsure
        came = np.isfinite(imu).all(axis=1)
        weight = self._weights[0] * came
        if weight.sum() > 0.5 and expected.imu.size:  # half of the readings: the mean is still that of the window
            self.imu_off = weight[came] @ imu[came] / weight.sum() - expected.imu
        return True
