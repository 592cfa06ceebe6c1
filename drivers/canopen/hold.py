"""What a hold is: the axis comes to rest as fast as its limits say, and then stays in its place. A drive under which it does not pushes it.

So does one that goes on with more effort than any pose takes: an axis that stands against it is held by something else.

Each encoder is followed for itself. In the direction in which it moved when the hold began, it may go as far as the limit of acceleration
takes to end that speed; back from the furthest place it may not go; both but for a window.
"""

from __future__ import annotations

from math import copysign, isfinite, nan

from drivers.settings import MotionLimits

ANSWER_S = 0.03
"""Time in which a drive shows that it obeys: two ticks from a controlword to its statusword, and as many again for lost frames."""

OUTSIDE_TICKS = 3  # in a row: a damaged frame makes one
JUMP = 6.0
"""Multiple of the speed limit that is a counter which was set, not a motion, unless the next step goes on as far."""

CREEP_S = 5.0
CREEP_SHARE = 0.1
"""Share of the window by which an axis may creep in `CREEP_S`, to be held from there on: a velocity loop does not know its place. An effort
that holds is judged over the same time."""


class _Path:
    """One encoder's way since the hold began."""

    def __init__(self, limits: MotionLimits, period_s: float) -> None:
        self._window = limits.tracking_error
        self._deceleration = min(limits.acceleration, limits.quick_stop or limits.acceleration)
        self._period_s, self._jump = period_s, JUMP * limits.speed * period_s
        self.begin()

    def begin(self) -> None:
        self._last, self._since = nan, 0  # ticks since the last position
        self._jumped = 0.0  # the last step, where it was too long
        self._moved = self._moved_s = self._time_s = 0.0
        self._anchored_s = nan  # NaN: the drive has yet to answer
        self._zero = self._speed = self._furthest = 0.0
        self._seen_s = self._seen_at = 0.0  # when and where it was seen not to creep
        self._outside = 0

    def step(self, position: float, ticks: int) -> float:
        """Take a position, `ticks` after the one before; return how far the axis has left what a hold is, 0 where it has not."""
        self._time_s += ticks * self._period_s
        self._since += ticks
        if isfinite(position):
            step = position - self._last if isfinite(self._last) else 0.0
            jumped = step if abs(step) > self._jump * self._since else 0.0
            if not jumped or jumped * self._jumped > 0.0:
                self._moved += step
                self._moved_s += self._since * self._period_s if isfinite(self._last) else 0.0
            self._jumped, self._last, self._since = jumped, position, 0
        if self._time_s <= ANSWER_S:
            return 0.0
        if not isfinite(self._anchored_s):
            self._anchor(self._moved / self._moved_s if self._moved_s > 0.0 else 0.0)
        along = copysign(1.0, self._speed) * (self._moved - self._zero)
        allowed = self._allowed()
        self._furthest = max(self._furthest, min(along, allowed))
        beyond = along - allowed if along > allowed else along - self._furthest
        self._outside = self._outside + ticks if abs(beyond) > self._window else 0
        leaves = beyond * copysign(1.0, self._speed) if self._outside >= OUTSIDE_TICKS else 0.0
        if self._time_s - self._seen_s >= CREEP_S:
            if abs(self._moved - self._seen_at) <= CREEP_SHARE * self._window:
                self._anchor(0.0)
            self._seen_s, self._seen_at = self._time_s, self._moved
        return leaves

    def _anchor(self, speed: float) -> None:
        self._anchored_s, self._zero, self._speed, self._furthest = self._time_s, self._moved, speed, 0.0

    def _allowed(self) -> float:
        speed = abs(self._speed)
        ramp_s = min(self._time_s - self._anchored_s, speed / self._deceleration)
        return ramp_s * (speed - 0.5 * self._deceleration * ramp_s) if ramp_s > 0.0 else 0.0


class _Push:
    """The effort of a hold, once the axis may have come to rest: a low pass that begins at nothing.

    A drive that brakes an axis beside its closing brake is left with some of that effort; the proof of the brake takes it from it long
    before `CREEP_S`.
    """

    def __init__(self, limits: MotionLimits, rated: float, period_s: float) -> None:
        self._most, self._rated, self._period_s = limits.holding_effort, rated, period_s
        self._ramp_s = limits.speed / min(limits.acceleration, limits.quick_stop or limits.acceleration)
        self.begin()

    def begin(self) -> None:
        self._time_s = self._mean = 0.0
        self._span = (0.0, 0.0)

    def step(self, effort: float, ticks: int) -> str:
        """Take a measured effort, NaN where none came; return why it is more than a hold takes, or ''."""
        self._time_s += ticks * self._period_s
        if isfinite(effort) and self._time_s > self._ramp_s:
            self._mean += (effort - self._mean) * min(1.0, ticks * self._period_s / CREEP_S)
            self._span = min(self._span[0], effort), max(self._span[1], effort)
        if abs(self._mean) <= self._most:
            return ""
        largest, most = self._span[self._mean > 0.0] / self._rated, self._most / self._rated
        return f"it gives up to {largest:+.0%} of its rated effort, at most {most:.0%} hold the axis at any pose"


class Hold:
    """Whether a drive that is told to stop and to hold its axis does.

    Parameters
    ----------
    limits : MotionLimits
    unit : str
        Of its positions, for messages.
    period_s : float
        Between ticks.
    rated : float
        Effort of the drive, for messages, in its unit.
    """

    def __init__(self, limits: MotionLimits, unit: str, period_s: float, rated: float) -> None:
        self._unit = unit
        self._push = _Push(limits, rated, period_s)
        self._paths = (("its motor side", _Path(limits, period_s)), ("its link", _Path(limits, period_s)))
        self._window = limits.tracking_error

    def begin(self) -> None:
        """Begin anew: the drive has just been told."""
        self._push.begin()
        for _, path in self._paths:
            path.begin()

    def step(self, motor: float, link: float, effort: float, ticks: int) -> str:
        """Take both encoders' positions and the effort, NaN where none came, `ticks` after the last; return why this is no hold, or ''."""
        found = self._push.step(effort, ticks)
        for (name, path), position in zip(self._paths, (motor, link), strict=True):
            if (beyond := path.step(position, ticks)) and not found:
                found = f"{name} is {beyond:+.1e} {self._unit} from where a stop brings it, {self._window:.1e} {self._unit} are allowed"
        return found


class Carried:
    """The most effort with which a drive has held an axis that stood, against what it gives now: the encoders may be frozen.

    Parameters
    ----------
    friction : float
        Bound of the axis's dry friction, in the drive's unit: its effort may change by twice as much while the load stays.
    rated : float
        Of the drive, for messages.
    """

    def __init__(self, friction: float, rated: float) -> None:
        self._between, self._rated, self._most = 2.0 * friction, rated, 0.0

    def take(self, effort: float) -> None:
        """Take the effort that holds an axis which stands; NaN where it is not known."""
        self._most = effort if abs(effort) > abs(self._most) else self._most

    def lost(self, effort: float) -> str:
        """Return how much less is given now, in words; '' where friction can carry what is missing."""
        if not (self._most - effort) * self._most > self._between * abs(self._most):
            return ""
        now, before = effort / self._rated, self._most / self._rated
        return f"; its drive gives {now:+.0%} of its rated effort, it gave {before:+.0%}: something else carries it, or nothing"
