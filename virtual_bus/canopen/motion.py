"""The drive's own motion: the slow velocity loop that moves and stops the motor when no master commands torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import scipy.signal

STANDSTILL_S = 0.078  # below the standstill speed for so long: the motor stands
_ROUNDING_S = 1e-9  # a time that is a whole number of samples is over at that sample


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


class TorqueFilter:
    """Filter of the velocity loop's torque: second-order sections (b0, b1, b2, 1, a1, a2) with a static gain of 1."""

    def __init__(self, sections: Sequence[Sequence[float]]) -> None:
        self._sections = [tuple(section) for section in sections]
        self._standing = scipy.signal.sosfilt_zi(sections).tolist() if self._sections else []
        self._state: list[list[float]] = [[0.0, 0.0] for _ in self._sections]

    def start(self, torque: float) -> None:
        """Begin where this torque has been passed on for long."""
        self._state = [[torque * first, torque * second] for first, second in self._standing]

    def step(self, torque: float) -> float:
        """Return the filtered torque of this sample."""
        for (b0, b1, b2, _, a1, a2), state in zip(self._sections, self._state, strict=True):
            passed = b0 * torque + state[0]
            state[0], state[1] = b1 * torque - a1 * passed + state[1], b2 * torque - a2 * passed
            torque = passed
        return torque

    @property
    def passed_at_once(self) -> float:
        """Share of a step that is passed on in the same sample."""
        return math.prod(section[0] for section in self._sections)

    def foreseen(self, torque: float) -> float:
        """Return what `step` would return; nothing changes."""
        for section, state in zip(self._sections, self._state, strict=True):
            torque = section[0] * torque + state[0]
        return torque


class VelocityLoop:
    """Proportional-integral speed control, bumpless from the torque that acted before, with or without a ramp of the set point."""

    def __init__(
        self, gains: VelocityGains, period_s: float, standstill_counts_s: float, torque_sections: Sequence[Sequence[float]] = ()
    ) -> None:
        self._gains = gains
        self._filter = TorqueFilter(torque_sections)
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
        self._filter.start(torque_permille)
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
        """Return the torque [per mille of rated] for this sample: filtered integral + proportional * lag, + feedforward, in limits."""
        lag = demand_counts_s - speed_counts_s
        wanted = self._filter.step(self._integral + self._gains.proportional * lag) + feedforward_permille
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
        proportional = self._gains.proportional * (demand_counts_s - speed_counts_s)
        if start_permille is None:
            wanted = self._filter.foreseen(self._integral + proportional) + feedforward_permille
        else:
            wanted = start_permille + self._filter.passed_at_once * proportional + feedforward_permille
        return min(max(wanted, -limit_permille), limit_permille)
