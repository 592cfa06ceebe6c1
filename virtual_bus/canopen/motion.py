"""The drive's own speed: how it is measured, and the slow velocity loop that moves and stops the motor when no master commands torque."""

from __future__ import annotations

import math
from dataclasses import dataclass

STANDSTILL_S = 0.078  # below the standstill speed for so long: the motor stands
_SPEED_FILTER = 0.25  # share of the newest difference: the encoder's counts are coarse at slow speed
_ROUNDING_S = 1e-9  # a time that is a whole number of samples is over at that sample


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


class Dwell:
    """Whether something has been so, sample after sample, for a time."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._samples = 0

    def restart(self) -> None:
        """Begin anew."""
        self._samples = 0

    def held(self, holds: bool, time_s: float) -> bool:
        """Take one sample and return whether it has been so for this time, which the first sample of a row begins."""
        self._samples = self._samples + 1 if holds else 0
        return holds and (self._samples - 1) * self._period_s >= time_s - _ROUNDING_S


@dataclass(frozen=True)
class VelocityGains:
    """Per mille of rated torque per count/s, and per count of accumulated lag."""

    proportional: float
    integral: float


class VelocityLoop:
    """Proportional-integral speed control, bumpless from the torque that acted before, with or without a ramp of the set point."""

    def __init__(self, gains: VelocityGains, period_s: float, standstill_counts_s: float) -> None:
        self._gains = gains
        self._period_s = period_s
        self._standstill_counts_s = standstill_counts_s
        self.set_counts_s = 0.0  # the ramp's present speed
        self._integral = 0.0
        self._still = 0
        self._still_samples = math.ceil(STANDSTILL_S / period_s)

    def start(self, speed_counts_s: float, torque_permille: float) -> None:
        """Take over at the present speed and torque."""
        self.set_counts_s = speed_counts_s
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
        self.set_counts_s += min(max(target_counts_s - self.set_counts_s, -step), step)
        torque = self.follow(self.set_counts_s, speed_counts_s, 0.0, limit_permille)
        still = self.set_counts_s == 0.0 and abs(speed_counts_s) <= self._standstill_counts_s
        self._still = self._still + 1 if still else 0
        return torque

    def follow(self, demand_counts_s: float, speed_counts_s: float, feedforward_permille: float, limit_permille: float) -> float:
        """Return the torque [per mille of rated] for this sample: integral + proportional * lag + feedforward, within the limit."""
        lag = demand_counts_s - speed_counts_s
        wanted = self._integral + self._gains.proportional * lag + feedforward_permille
        torque = min(max(wanted, -limit_permille), limit_permille)
        if torque == wanted:  # no wind-up against the limit
            self._integral += self._gains.integral * lag * self._period_s
        return torque

    def foreseen(
        self,
        demand_counts_s: float,
        speed_counts_s: float,
        feedforward_permille: float,
        limit_permille: float,
        *,
        start_permille: float | None = None,
    ) -> float:
        """Return what `follow` would return, after a `start` at that torque where one is given; nothing changes."""
        integral = self._integral if start_permille is None else start_permille
        wanted = integral + self._gains.proportional * (demand_counts_s - speed_counts_s) + feedforward_permille
        return min(max(wanted, -limit_permille), limit_permille)
