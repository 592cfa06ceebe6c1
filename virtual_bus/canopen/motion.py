"""The drive's own slow velocity loop, which moves and stops the motor when no master commands the torque."""

from __future__ import annotations

import math
from dataclasses import dataclass

STANDSTILL_S = 0.078  # below the standstill speed for so long: the motor stands
_SPEED_FILTER = 0.25  # share of the newest difference: the encoder's counts are coarse at slow speed


class SpeedMeter:
    """Speed from encoder counts: differences, smoothed by a first-order filter."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._last: int | None = None
        self.counts_s = 0.0

    def restart(self) -> None:
        """Begin anew: the counter has jumped or starts."""
        self._last = None
        self.counts_s = 0.0

    def update(self, counts: int) -> None:
        """Take the count of one sample."""
        if self._last is not None:
            self.counts_s += _SPEED_FILTER * ((counts - self._last) / self._period_s - self.counts_s)
        self._last = counts


@dataclass(frozen=True)
class VelocityGains:
    """Per mille of rated torque per count/s, and per count of accumulated lag."""

    proportional: float
    integral: float


class VelocityLoop:
    """Proportional-integral speed control with a ramped set point, bumpless from the torque that acted before."""

    def __init__(self, gains: VelocityGains, period_s: float, standstill_counts_s: float) -> None:
        self._gains = gains
        self._period_s = period_s
        self._standstill_counts_s = standstill_counts_s
        self._set_counts_s = 0.0
        self._integral = 0.0
        self._still = 0
        self._still_samples = math.ceil(STANDSTILL_S / period_s)

    def start(self, speed_counts_s: float, torque_permille: float) -> None:
        """Take over at the present speed and torque."""
        self._set_counts_s = speed_counts_s
        self._integral = torque_permille
        self._still = 0

    @property
    def standing(self) -> bool:
        """Whether the set point is zero and the motor has stood for a while."""
        return self._still >= self._still_samples

    def torque(self, target_counts_s: float, acceleration_counts_s2: float, speed_counts_s: float, limit_permille: float) -> float:
        """Return the torque [per mille of rated] for this sample.

        The set point approaches the target at the given acceleration.
        """
        step = acceleration_counts_s2 * self._period_s
        self._set_counts_s += min(max(target_counts_s - self._set_counts_s, -step), step)
        lag = self._set_counts_s - speed_counts_s
        wanted = self._integral + self._gains.proportional * lag
        torque = min(max(wanted, -limit_permille), limit_permille)
        if torque == wanted:  # no wind-up against the limit
            self._integral += self._gains.integral * lag * self._period_s
        still = self._set_counts_s == 0.0 and abs(speed_counts_s) <= self._standstill_counts_s
        self._still = self._still + 1 if still else 0
        return torque
