"""Bounds on the motion of an axis while a brake is open or a drive powered: held, pushed, homed or led by the sample loop.

Both encoders of an axis are watched, each from its position at the start of the phase: a motor-side encoder that is frozen, lost or counts
the wrong way is detected by the link encoder, and vice versa. With a single encoder that is frozen, a falling axis is not detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite, nan

from drivers.interface import Clock, Sample
from drivers.settings import AxisScaling, HomingSettings, MotionLimits

STANDING_SHARE = 0.1
"""Share of the tracking error that stops a run by which a held axis may move: 5 mrad on the C-arm, where the first move takes 0.5."""

HOMING_SPEED_MARGIN = 2.0
"""Multiple of its homing speed that the motor side may reach: a drive's velocity loop overshoots, one of wrong sign runs away and exceeds
this. The link swings behind its gear when the drive starts, so only the axis' speed limit applies to it."""

LED_SPEED_MARGIN = 1.5
"""Multiple of its speed limit that an axis may reach under the sample loop: the reference keeps to the limit, excitation adds to it."""

STILL_S = 0.5
"""Longest time without motion of the motor side while its drive homes: turning round at a switch takes half of it."""

COUNTS = 1.5
"""Encoder counts by which a position may flicker."""


class _Track:
    """The path of one encoder since a phase began."""

    def __init__(self, name: str, resolution: float) -> None:
        self.name = name
        self.flicker = COUNTS * resolution
        self.begin()

    def begin(self, *, may_jump: bool = False) -> None:
        """From here on; `may_jump`: the drive will once set its counter to what homing found."""
        self.moved = 0.0
        self.stale = 0
        self.step = 0.0
        self.may_jump = may_jump
        self._last = nan
        self._ticks = 0

    def update(self, position: float, ticks: int, speed_per_tick: float, *, late: bool) -> bool:
        """Take the newest position, `ticks` after the one before; whether it moved no faster than it may.

        `late`: it answers an earlier SYNC, and is not known; its encoder is not silent.
        """
        self._ticks += ticks
        self.stale = 1 if late else self.stale + 1
        if not isfinite(position):
            return True
        self.stale = 0
        self.step = position - self._last if isfinite(self._last) else 0.0
        allowed = speed_per_tick * self._ticks + self.flicker
        self._last, self._ticks = position, 0
        if abs(self.step) > allowed:
            if not self.may_jump:
                return False
            self.may_jump, self.step = False, 0.0
        self.moved += self.step
        return True


class _AxisWatch:
    """The bounds of one axis and the paths of its two encoders."""

    def __init__(self, limits: MotionLimits, scaling: AxisScaling, period_s: float) -> None:
        self.limits = limits
        self.homed = False
        self.unit = scaling.position_unit
        self._period_s = period_s
        self._motor = _Track("motor side", scaling.position_resolution)
        self._link = _Track("link encoder", scaling.link_resolution) if scaling.link_resolution else None
        self.stand()

    def stand(self, share: float = STANDING_SHARE, *, sets_counter: bool = False) -> None:
        """Begin a phase in which the axis is held in place."""
        self._begin(share * self.limits.tracking_error, self.limits.speed, sets_counter=sets_counter)
        self._doing = "while it should stand"

    def lead(self) -> None:
        """Begin a phase in which the sample loop leads the axis and checks range and tracking error; the gear's ratio is not checked."""
        self._begin(inf, LED_SPEED_MARGIN * self.limits.speed, sets_counter=False)
        self._apart = self.limits.tracking_error
        self._link_may_be_silent = True
        self._doing = "while it was led"

    def home(self, settings: HomingSettings) -> None:
        """Begin a phase in which the drive moves the axis to find its zero."""
        self._begin(settings.travel_limit, HOMING_SPEED_MARGIN * settings.speed, sets_counter=True)
        self._still_ticks = STILL_S / self._period_s
        self._in_range = False
        self._doing = f"while it homed by method {settings.method}"

    def _begin(self, travel: float, speed: float, *, sets_counter: bool) -> None:
        self._travel, self._speed, self._in_range = travel, speed, True
        self._link_speed = max(speed, self.limits.speed)
        self._apart, self._link_may_be_silent = STANDING_SHARE * self.limits.tracking_error, False
        self._still_ticks, self._still, self._still_at = inf, 0, 0.0
        self._motor.begin(may_jump=sets_counter)
        if self._link is not None:
            self._link.begin()

    def check(self, position: float, link: float, ticks: int, *, late: bool, link_late: bool) -> str:
        """Return what is wrong with this tick, in words; '' when nothing is."""
        return (
            self._bounds(self._motor, position, ticks, self._speed, late=late)
            or (self._bounds(self._link, link, ticks, self._link_speed, late=link_late) if self._link is not None else "")
            or self._stillness(ticks)
            or self._disagreement()
            or self._range(position, link)
        )

    def _bounds(self, track: _Track, position: float, ticks: int, speed: float, *, late: bool) -> str:
        slow = track.update(position, ticks, speed * self._period_s, late=late)
        limits = self.limits
        if track.stale > limits.stale_ticks and not (self._link_may_be_silent and track is self._link):
            what = f"no position for {track.stale} ticks, timing.stale_ticks bridges {limits.stale_ticks}"
        elif not slow:
            what = f"moved by {track.step:+.2e} {self.unit} at once {self._doing}; {speed:.3g} {self.unit}/s is allowed"
        elif abs(track.moved) > self._travel:
            what = f"moved by {track.moved:+.2e} {self.unit} {self._doing}; {self._travel:.2e} {self.unit} is allowed"
        else:
            return ""
        return f"{limits.axis}: {track.name}: {what}"

    def _stillness(self, ticks: int) -> str:
        # over as many ticks as it takes: a slow axis gives a count only from time to time
        if abs(self._motor.moved - self._still_at) > self._motor.flicker:
            self._still, self._still_at = 0, self._motor.moved
        else:
            self._still += ticks
        if self._still > self._still_ticks:
            return f"{self.limits.axis}: its motor side shows no motion for {STILL_S:g} s {self._doing}; brake, motor or encoder"
        return ""

    def _disagreement(self) -> str:
        if self._link is None:
            return ""
        motor, link = self._motor.moved, self._link.moved
        if abs(motor - link) > self._apart and self._link.stale > self.limits.stale_ticks:
            return (
                f"{self.limits.axis}: link encoder: no position for {self._link.stale} ticks, and its motor side moved by "
                f"{motor - link:+.2e} {self.unit} {self._doing}; {self._apart:.2e} {self.unit} is allowed"
            )
        if abs(motor - link) > self._apart:
            return (
                f"{self.limits.axis}: its motor side moved by {motor:+.2e} {self.unit}, its link encoder by {link:+.2e} {self._doing}; "
                f"they may differ by {self._apart:.2e}: one of them is frozen, counts the wrong way, or the gear between them slips"
            )
        return ""

    def _range(self, position: float, link: float) -> str:
        if not self._in_range:
            return ""
        limits = self.limits
        for value, name, known, slack in (
            (position, "position", self.homed, 0.0),
            (link, "link position", True, limits.tracking_error),  # wound up by the load on the gear
        ):
            if known and isfinite(value) and not limits.lower - slack <= value <= limits.upper + slack:
                return f"{limits.axis}: {name} {value:.4f} {self.unit} is outside {limits.lower:.4f} to {limits.upper:.4f} {self.unit}"
        return ""


class MotionWatch:
    """Watches every axis, tick by tick, within the bounds of the current phase.

    Parameters
    ----------
    limits : sequence of MotionLimits
    scalings : sequence of AxisScaling
        Both in axis order.
    clock : Clock
    period_s : float
        Between ticks.
    """

    def __init__(self, limits: Sequence[MotionLimits], scalings: Sequence[AxisScaling], clock: Clock, period_s: float) -> None:
        self._axes = [_AxisWatch(limit, scaling, period_s) for limit, scaling in zip(limits, scalings, strict=True)]
        self._clock = clock
        self._missed = 0
        self._ticks = 0  # since somebody answered

    def forget(self) -> None:
        """Mark every axis as not homed, because the counters start again."""
        for axis in self._axes:
            axis.homed = False

    def homed(self, axis: int) -> None:
        """Mark an axis as homed: its motor-side position is the joint's."""
        self._axes[axis].homed = True

    def stand(self, *, sets_counter: int | None = None) -> None:
        """Hold every axis in place; the drive of `sets_counter` takes its position as zero without moving."""
        self._missed = self._clock.missed
        for index, axis in enumerate(self._axes):
            axis.stand(sets_counter=index == sets_counter)

    def settle(self) -> None:
        """Let every axis come to rest after a run; it may swing as far as the run allowed."""
        self._missed = self._clock.missed
        for axis in self._axes:
            axis.stand(1.0)

    def lead(self) -> None:
        """Let the sample loop lead every axis."""
        self._missed = self._clock.missed
        for axis in self._axes:
            axis.lead()

    def home(self, axis: int, settings: HomingSettings) -> None:
        """Let the drive of one axis move it to find its zero; all others are held."""
        self.stand()
        self._axes[axis].home(settings)

    def check(self, sample: Sample) -> str:
        """Return what is wrong with this tick, in words; '' when nothing is."""
        missed = self._clock.missed
        self._ticks += 1 + max(0, missed - self._missed)
        self._missed = missed
        if sample.unanswered:  # the bus is late, and no axis is silent
            return ""
        ticks, self._ticks = self._ticks, 0
        answers = zip(
            sample.position.tolist(), sample.link_position.tolist(), sample.position_late.tolist(), sample.link_late.tolist(), strict=True
        )
        for axis, (position, link, late, link_late) in zip(self._axes, answers, strict=True):
            if reason := axis.check(position, link, ticks, late=late, link_late=link_late):
                return reason
        return ""
