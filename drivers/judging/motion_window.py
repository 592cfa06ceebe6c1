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

from drivers.interface import Sample

WINDOW_S = 0.5
"""Time over which means are taken: two periods of the slowest vibration, and short against a run."""


@dataclass(frozen=True)
class Expected:
    """What a machine file makes of a motion."""

    effort: np.ndarray  # (axes,) drive's unit, friction included
    unsure: np.ndarray  # (axes,) drive's unit: standard deviation, where friction has no known direction
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
        self._weights = np.stack((weight, -0.5 * rate * np.sin(phase), 0.5 * rate**2 * np.cos(phase)), axis=1) / weight.sum()
        self.begin()

    def begin(self) -> None:
        """Begin anew: nothing is known."""
        self.over = False
        self.effort_off = np.full(self._axes, nan)
        self.effort_unsure = np.full(self._axes, nan)
        self.imu_off = np.full(6, nan)
        self._restart()

    def _restart(self) -> None:
        self._tick = 0
        self._motion = np.zeros((3, 2, self._axes))  # position, speed, acceleration; motor side, link
        self._squares = np.zeros(self._axes)  # of the motor side's speed
        self._last = np.full(self._axes, nan)
        self._effort = np.zeros(self._axes)
        self._imu, self._imu_weight = np.zeros(6), 0.0

    def step(self, sample: Sample, ticks: int) -> None:
        """Take the newest sample; `ticks` passed since the one before. A gap in the axes' readings begins the window anew."""
        self.over = False
        if ticks != 1:
            self._restart()
        both = np.stack((sample.position, np.where(np.isnan(sample.link_position), sample.position, sample.link_position)))
        if not (np.isfinite(both).all() and np.isfinite(sample.effort).all()):
            self._restart()
            return
        weights = self._weights[self._tick]
        self._motion += weights[:, None, None] * both
        if self._tick:
            self._squares += weights[0] * ((sample.position - self._last) / self._period_s) ** 2
        self._last[:] = sample.position
        self._effort += weights[0] * sample.effort
        if np.isfinite(sample.imu).all():
            self._imu += weights[0] * sample.imu
            self._imu_weight += weights[0]
        self._tick += 1
        if self._tick == self.ticks:
            self._compare()
            self._restart()
            self.over = True

    def _compare(self) -> None:
        position, speed, acceleration = self._motion
        deviation = np.sqrt(np.maximum(self._squares - speed[0] ** 2, 0.0))
        expected = self._expects(Means(position, speed, acceleration, deviation, self._effort))
        self.effort_off = self._effort - expected.effort
        self.effort_unsure = expected.unsure
        if self._imu_weight > 0.5 and expected.imu.size:  # half of the readings: the mean is still that of the window
            self.imu_off = self._imu / self._imu_weight - expected.imu
