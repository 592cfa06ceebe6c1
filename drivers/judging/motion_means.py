"""Means of a motion over a window, and what a machine file makes of it: what both sides of the comparison know, without a compiler."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

ORDERS = 3  # position, speed and acceleration
DEVIATION, EFFORT = 2 * ORDERS, 2 * ORDERS + 1  # rows of `Means`
ROWS = EFFORT + 1


@dataclass(frozen=True)
class Expected:
    """What a machine file makes of a motion."""

    effort: np.ndarray  # (axes,) drive's unit, friction included
    unsure: np.ndarray  # (axes,) drive's unit: standard deviation, of friction without a known direction and of the load
    imu: np.ndarray  # (6,) m/s^2 and rad/s; empty without an IMU


@dataclass(frozen=True)
class Means:
    """Means over a window.

    Parameters
    ----------
    rows : (ROWS, axes) array
        Position, speed and acceleration, of motor side and link each; the deviation of the motor side's speed about its mean; the effort.
    """

    rows: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """Return (2, axes) rad or m: motor side, link."""
        return self.rows[0:2]

    @property
    def speed(self) -> np.ndarray:
        """Return (2, axes)."""
        return self.rows[2:4]

    @property
    def acceleration(self) -> np.ndarray:
        """Return (2, axes)."""
        return self.rows[4:6]

    @property
    def deviation(self) -> np.ndarray:
        """Return (axes,) of the motor side's speed about its mean."""
        deviation: np.ndarray = self.rows[DEVIATION]
        return deviation

    @property
    def effort(self) -> np.ndarray:
        """Return (axes,) in the drive's unit."""
        effort: np.ndarray = self.rows[EFFORT]
        return effort


Expects = Callable[[Means], Expected]
