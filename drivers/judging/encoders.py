"""Are an axis's two encoders to be believed: neither jumps, and they do not part beyond what the spring between them carries."""

from __future__ import annotations

from math import isfinite, nan

from drivers.interface import Sample
from drivers.judging.settings import EncoderJudging

WINDOW_S = 0.5
"""Time over which the difference of both encoders is averaged: vibrations of the structure, above 4 Hz, leave nothing in it."""

GROWING = 4
"""Windows in a row in which a difference must grow to count as a drift. What friction and play leave ends soon after the reversal."""

COUNTS = 4.0
"""Counts by which the second difference of a sound encoder can be off: twice the two that rounding its three readings makes."""


class _Jump:
    """Looks for a step of one encoder that no acceleration can make: its second difference is the acceleration times the period squared."""

    def __init__(self, name: str, resolution: float, acceleration: float, period_s: float) -> None:
        self.name, self.resolution = name, resolution
        self._period_s = period_s
        self._allowed = acceleration * period_s**2 + COUNTS * resolution
        self.begin()

    def begin(self) -> None:
        """Begin anew, or after a gap."""
        self.second = nan
        self.allowed = self._allowed
        self._last = self._before = nan
        self._late = self._late_before = 0.0

    def step(self, position: float, lateness_s: float) -> bool:
        """Return whether the newest position is a jump."""
        self.second = position - 2.0 * self._last + self._before
        late = abs(lateness_s) + 2.0 * abs(self._late) + abs(self._late_before)  # a late SYNC latches a moving axis further on
        speed = max(abs(position - self._last), abs(self._last - self._before)) / self._period_s
        self.allowed = self._allowed + speed * late
        self._before, self._last = self._last, position
        self._late_before, self._late = self._late, lateness_s
        return abs(self.second) > self.allowed  # False while there are no three positions


class EncoderJudge:
    """Judges motor side and link encoder of one axis.

    A finding other than silence stands to the end: a counter that has lost counts does not find them again.

    Parameters
    ----------
    settings : EncoderJudging

    Attributes
    ----------
    lag_ticks : int
        For how many ticks before the newest one the readings are in doubt too.
    """

    def __init__(self, settings: EncoderJudging) -> None:
        self.sensor, self.follows = settings.sensor, settings.follows
        self._settings = settings
        self._window = max(1, round(WINDOW_S / settings.period_s))
        self._motor = _Jump("motor side", settings.motor_resolution, settings.motor_acceleration, settings.period_s)
        self._link = _Jump("link encoder", settings.link_resolution, settings.link_acceleration, settings.period_s)
        self._has_link = settings.link_resolution > 0.0
        self.begin()

    def begin(self) -> None:
        """Begin anew, with both encoders as they are."""
        self.lag_ticks = 0
        self._found = self._words = ""
        self._silent = 0
        self._motor.begin()
        self._link.begin()
        self._position = self._speed = nan
        self._ticks = self._summed = 0
        self._sum = 0.0
        self._first = self._apart = nan
        self._growing = 0

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        settings = self._settings
        axis = settings.axis
        motor, link = float(sample.position[axis]), float(sample.link_position[axis])
        self.lag_ticks = 0
        if ticks != 1:
            self._motor.begin()
            self._link.begin()
            self._speed = nan
        self._look(self._motor, motor, sample.lateness_s)
        if self._has_link:
            self._look(self._link, link, sample.lateness_s)
            self._compare(motor, link, float(sample.effort[axis]), ticks)
            self._silent = 0 if isfinite(link) else self._silent + ticks
            if not self._found and self._silent > settings.stale_ticks:
                self.lag_ticks = self._silent - 1
                return "silent"
        return self._found

    def finish(self) -> str:
        """Judge the window that a run's end cuts off, where at least half of it is there; return which check fails, or ''."""
        if 2 * self._summed >= self._window:
            self._judge_window(self._sum / self._summed)
            self._ticks = self._summed = 0
            self._sum = 0.0
        return self._found

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        if check == "silent":
            return f"its link encoder has sent nothing for more than {self._settings.stale_ticks} ticks"
        return self._words

    def _look(self, encoder: _Jump, position: float, lateness_s: float) -> None:
        if not isfinite(position):
            encoder.begin()
        elif encoder.step(position, lateness_s) and not self._found:
            self._found = "jump"
            counts, allowed = encoder.second / encoder.resolution, encoder.allowed / encoder.resolution
            self._words = f"its {encoder.name} jumped by {counts:+.0f} counts between two samples; motion makes at most {allowed:.0f}"

    def _compare(self, motor: float, link: float, effort: float, ticks: int) -> None:
        """Average what the difference of both encoders is beyond the windup, and judge every window that is over."""
        settings, period_s = self._settings, self._settings.period_s
        speed = (motor - self._position) / period_s if ticks == 1 else nan
        acceleration = (speed - self._speed) / period_s
        self._position, self._speed = motor, speed
        windup = 0.0
        if settings.compliance > 0.0:
            load = settings.inertia * acceleration + settings.damping * speed - settings.effort_scale * effort
            windup = settings.compliance * load
        apart = link - motor - windup
        if isfinite(apart):
            self._sum += apart
            self._summed += 1
        self._ticks += ticks
        if self._ticks >= self._window:
            if 2 * self._summed >= self._window:
                self._judge_window(self._sum / self._summed)
            self._ticks = self._summed = 0
            self._sum = 0.0

    def _judge_window(self, apart: float) -> None:
        settings = self._settings
        if not isfinite(self._first):
            self._first = self._apart = apart
        step, departed = apart - self._apart, apart - self._first
        self._apart = apart
        self._growing = self._growing + 1 if step * departed > 0.0 and abs(step) > settings.growth else 0
        if self._found:
            return
        if self._growing >= GROWING and abs(departed) > settings.drift:
            self._found = "drift"
            self.lag_ticks = self._growing * self._window
            self._words = (
                f"its link encoder has departed from the motor side by {departed:+.2e} {settings.unit} and goes on at "
                f"{step / WINDOW_S:+.1e} {settings.unit}/s; {settings.drift:.2e} are allowed: one of them drifts"
            )
        elif abs(apart) > settings.tolerance:
            self._found = "apart"
            self.lag_ticks = self._window
            self._words = (
                f"its link encoder stands {apart:+.2e} {settings.unit} from where motor side and load put it; "
                f"{settings.tolerance:.2e} are allowed"
            )
