"""Trapezoidal profiles in closed form: the fastest way to rest at a target within a speed, an acceleration and a deceleration.

Accelerating means that the speed's magnitude grows, as in 6083h and 6084h of IEC 61800-7-201; where both are equal this is the
time-optimal trajectory with unlimited jerk.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate, pairwise


@dataclass(frozen=True)
class Limits:
    """What a profile keeps to, all positive: counts/s, counts/s^2, counts/s^2."""

    speed: float
    acceleration: float
    deceleration: float


class Profile:
    """A piecewise parabolic way, exact at every time.

    Parameters
    ----------
    position, speed : float
        Where it begins [counts, counts/s].
    pieces : sequence of (float, float)
        Duration [s] and acceleration [counts/s^2] of each piece.
    end : float, optional
        Where it rests for ever after; None: where the pieces lead.

    Attributes
    ----------
    duration_s : float
        When it rests.
    end : float
        Position at which it rests.
    """

    def __init__(self, position: float, speed: float, pieces: list[tuple[float, float]], end: float | None = None) -> None:
        self._pieces: list[tuple[float, float, float, float]] = []  # start time, position, speed, acceleration
        starts = [0.0, *accumulate(duration for duration, _ in pieces)]
        for (start, stop), (_, acceleration) in zip(pairwise(starts), pieces, strict=True):
            duration = stop - start
            self._pieces.append((start, position, speed, acceleration))
            position += (speed + 0.5 * acceleration * duration) * duration
            speed += acceleration * duration
        self.duration_s = starts[-1]
        self.end = position if end is None else end

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position [counts] and speed [counts/s] at a time since the beginning."""
        if time_s >= self.duration_s:
            return self.end, 0.0
        start, position, speed, acceleration = next(piece for piece in reversed(self._pieces) if piece[0] <= max(time_s, 0.0))
        elapsed = time_s - start
        return position + (speed + 0.5 * acceleration * elapsed) * elapsed, speed + acceleration * elapsed


def to_rest(position: float, speed: float, deceleration: float) -> Profile:
    """Return the way to standstill, wherever that is."""
    return Profile(position, speed, [(abs(speed) / deceleration, -math.copysign(deceleration, speed))])


def to_target(position: float, speed: float, target: float, limits: Limits) -> Profile:
    """Return the fastest way to rest at `target` [counts].

    What moves the wrong way, or too fast to stop at the target, first comes to rest and then turns round; what is faster than
    `limits.speed` slows down to it.
    """
    braking = abs(speed) / limits.deceleration
    rest = position + 0.5 * speed * braking
    ahead = target - rest
    if speed * ahead < 0.0:
        turn = [(braking, -math.copysign(limits.deceleration, speed))]
        return Profile(position, speed, turn + _pieces(target - rest, 0.0, limits), target)
    return Profile(position, speed, _pieces(target - position, abs(speed), limits), target)


def _pieces(way: float, speed: float, limits: Limits) -> list[tuple[float, float]]:
    """Return the pieces of a way [counts] that begins at a speed [counts/s >= 0] in its own direction and is long enough to stop on."""
    length, a, d = abs(way), limits.acceleration, limits.deceleration
    peak = math.sqrt(max(length + 0.5 * speed**2 / a, 0.0) / (0.5 / a + 0.5 / d))
    if speed > limits.speed:
        first, top, change = (speed - limits.speed) / d, limits.speed, -d
    else:
        top = max(min(peak, limits.speed), speed)
        first, change = (top - speed) / a, a
    cruise = max(length - 0.5 * (speed + top) * first - 0.5 * top**2 / d, 0.0) / top if top > 0.0 else 0.0
    direction = math.copysign(1.0, way)
    return [(first, direction * change), (cruise, 0.0), (top / d, -direction * d)]


def ramped(speed: float, target: float, limits: Limits, period_s: float) -> float:
    """Return the speed [counts/s] one period on, on its way to a target speed: exact also where it changes direction within the period."""
    if speed * target < 0.0 or abs(target) < abs(speed):
        goal = target if speed * target > 0.0 else 0.0
        needed_s = abs(goal - speed) / limits.deceleration
        if needed_s >= period_s:
            return speed + math.copysign(limits.deceleration * period_s, goal - speed)
        speed, period_s = goal, period_s - needed_s
    step = limits.acceleration * period_s
    return speed + min(max(target - speed, -step), step)
