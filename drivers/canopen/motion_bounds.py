"""Bounds on the motion of an axis while a brake is open or a drive powered: held, pushed, homed or led by the sample loop.

Both encoders of an axis are watched, each from its position at the start of the phase: a motor-side encoder that is frozen, lost or counts
the wrong way is detected by the link encoder, and vice versa. With a single encoder that is frozen, a falling axis is not detected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, isfinite, nan

import numpy as np
from numba.extending import register_jitable

from drivers.interface import Clock, Sample
from drivers.records import Record, record_type
from drivers.sample_memory import values_in
from drivers.settings import LED_SPEED_MARGIN, AxisScaling, HomingSettings, MotionLimits

STANDING_SHARE = 0.1
"""Share of the tracking error that stops a run by which a held axis may move: 5 mrad on the C-arm, where the first move takes 0.5."""

HOMING_SPEED_MARGIN = 2.0
"""Multiple of its homing speed that the motor side may reach: a drive's velocity loop overshoots, one of wrong sign runs away and exceeds
this. The link swings behind its gear when the drive starts, so only the axis' speed limit applies to it."""

STILL_S = 0.5
"""Longest time without motion of the motor side while its drive homes: turning round at a switch takes half of it."""

COUNTS = 1.5
"""Encoder counts by which a position may flicker."""


NEVER = 2**62
"""Ticks that do not pass."""

ENCODERS = ("motor side", "link encoder")
CHECKS = ("", "silent", "fast", "far", "link silent", "link fast", "link far", "still", "part unheard", "part", "outside", "link outside")
_FINE, _SILENT, _FAST, _FAR = range(4)
_OF_LINK, _STILL, _PART_UNHEARD, _PART, _OUTSIDE, _LINK_OUTSIDE = 3, 7, 8, 9, 10, 11

TRACK = record_type(
    ("flicker", "f8"),  # rad or m
    ("speed_per_tick", "f8"),  # rad or m: most that it may move
    ("travel", "f8"),  # rad or m in all
    ("stale_ticks", "i8"),
    ("may_jump", "?"),  # the drive will once set its counter to what homing found
    # what was seen
    ("moved", "f8"),
    ("stale", "i8"),
    ("step", "f8"),
    ("last", "f8"),
    ("ticks", "i8"),  # since then
)
"""The path of one encoder since a phase began."""

WATCHED = record_type(
    ("motor", TRACK),
    ("link", TRACK),
    ("has_link", "?"),
    ("homed", "?"),
    ("in_range", "?"),
    ("lower", "f8"),
    ("upper", "f8"),
    ("slack", "f8"),  # of the link's range: it is wound up by the load on the gear
    ("stale_ticks", "i8"),
    ("apart", "f8"),  # between both encoders
    ("still_ticks", "f8"),
    ("still", "i8"),
    ("still_at", "f8"),
)
"""The bounds of one axis in the present phase, and the paths of its two encoders."""

Law = Callable[[np.ndarray, np.ndarray, int], int]
"""Checks every axis: bytes of their WATCHED, advanced in place; those of the sample; ticks since the one before. It returns 0, or the first
axis that is out of bounds times the number of `CHECKS`, plus which of these it fails; or -1 for a sample of other axes."""


@register_jitable
def _is_slow(track: Record, position: float, ticks: int, late: bool) -> bool:
    """Take the newest position, `ticks` after the one before; return whether it moved no faster than it may.

    `late`: it answers an earlier SYNC, and is not known; its encoder is not silent.
    """
    track.ticks += ticks
    track.stale = 1 if late else track.stale + 1
    if not isfinite(position):
        return True
    track.stale = 0
    track.step = position - track.last if isfinite(track.last) else 0.0
    allowed = track.speed_per_tick * track.ticks + track.flicker
    track.last, track.ticks = position, 0
    if abs(track.step) > allowed:
        if not track.may_jump:
            return False
        track.may_jump, track.step = False, 0.0
    track.moved += track.step
    return True


@register_jitable
def _bounded(track: Record, position: float, ticks: int, late: bool) -> int:
    """Return which check the path of an encoder fails, 0 when none."""
    is_slow = _is_slow(track, position, ticks, late)
    if track.stale > track.stale_ticks:
        return _SILENT
    if not is_slow:
        return _FAST
    return _FAR if abs(track.moved) > track.travel else _FINE


@register_jitable
def _is_still(axis: Record, ticks: int) -> bool:
    """Tell whether an axis that homes does not move, over as many ticks as it takes: a slow one gives a count only from time to time."""
    if abs(axis.motor.moved - axis.still_at) > axis.motor.flicker:
        axis.still, axis.still_at = 0, axis.motor.moved
    else:
        axis.still += ticks
    return bool(axis.still > axis.still_ticks)


@register_jitable
def _is_outside(axis: Record, position: float, slack: float) -> bool:
    """Tell whether a position that is known is out of the axis's range."""
    return bool(isfinite(position) and not axis.lower - slack <= position <= axis.upper + slack)


@register_jitable
def watched(axis: Record, values: Record, ticks: int) -> int:
    """Return which of `CHECKS` an axis fails, 0 when none; callable from compiled code.

    Parameters
    ----------
    axis : WATCHED
        Advanced in place.
    values : VALUES
        Of the axis.
    ticks : int
        Passed since the sample before.
    """
    found = _bounded(axis.motor, values.position, ticks, values.position_late)
    if found != _FINE:
        return found
    if axis.has_link:
        found = _bounded(axis.link, values.link_position, ticks, values.link_late)
        if found != _FINE:
            return _OF_LINK + found
    if _is_still(axis, ticks):
        return _STILL
    if axis.has_link and abs(axis.motor.moved - axis.link.moved) > axis.apart:
        return _PART_UNHEARD if axis.link.stale > axis.stale_ticks else _PART
    if axis.in_range and axis.homed and _is_outside(axis, values.position, 0.0):
        return _OUTSIDE
    if axis.in_range and _is_outside(axis, values.link_position, axis.slack):
        return _LINK_OUTSIDE
    return _FINE


def watched_axes(block: np.ndarray, sample: np.ndarray, ticks: int) -> int:
    """Check every axis, the first that fails ends it; a `Law`."""
    axes, values = block.view(WATCHED), values_in(sample)
    if len(values) != len(axes):
        return -1
    for k in range(len(axes)):
        found = watched(axes[k], values[k], ticks)
        if found != _FINE:
            return k * len(CHECKS) + found
    return _FINE


class _AxisWatch:
    """The bounds of one axis, phase by phase, and what was found in words."""

    def __init__(self, limits: MotionLimits, scaling: AxisScaling, period_s: float, state: Record) -> None:
        self.limits, self.state = limits, state
        self.unit = scaling.position_unit
        self._period_s = period_s
        state.motor.flicker, state.link.flicker = COUNTS * scaling.position_resolution, COUNTS * scaling.link_resolution
        state.has_link = scaling.link_resolution != 0.0
        state.lower, state.upper, state.slack, state.stale_ticks = limits.lower, limits.upper, limits.tracking_error, limits.stale_ticks
        self.stand()

    def stand(self, share: float = STANDING_SHARE, *, sets_counter: bool = False) -> None:
        """Begin a phase in which the axis is held in place."""
        self._begin(share * self.limits.tracking_error, self.limits.speed, sets_counter=sets_counter)
        self._doing = "while it should stand"

    def lead(self) -> None:
        """Begin a phase in which the sample loop leads the axis and checks range and tracking error; the gear's ratio is not checked."""
        self._begin(inf, LED_SPEED_MARGIN * self.limits.speed, sets_counter=False)
        self.state.apart = self.limits.tracking_error
        self.state.link.stale_ticks = NEVER
        self._doing = "while it was led"

    def home(self, settings: HomingSettings) -> None:
        """Begin a phase in which the drive moves the axis to find its zero."""
        self._begin(settings.travel_limit, HOMING_SPEED_MARGIN * settings.speed, sets_counter=True)
        self.state.still_ticks = STILL_S / self._period_s
        self.state.in_range = False
        self._doing = f"while it homed by method {settings.method}"

    def _begin(self, travel: float, speed: float, *, sets_counter: bool) -> None:
        state, self._speeds = self.state, (speed, max(speed, self.limits.speed))
        for track, allowed, may_jump in zip((state.motor, state.link), self._speeds, (sets_counter, False), strict=True):
            track.speed_per_tick, track.travel, track.stale_ticks = allowed * self._period_s, travel, self.limits.stale_ticks
            track.may_jump, track.moved, track.step, track.last = may_jump, 0.0, 0.0, nan
            track.stale = track.ticks = 0
        state.in_range, state.apart = True, STANDING_SHARE * self.limits.tracking_error
        state.still_ticks, state.still, state.still_at = inf, 0, 0.0

    def says(self, check: int, position: float, link: float) -> str:
        """Return a failed check in words."""
        if check < _STILL:
            at_link, what = divmod(check - 1, _OF_LINK)
            return f"{self.limits.axis}: {ENCODERS[at_link]}: {self._out_of_bounds(at_link, what + 1)}"
        return f"{self.limits.axis}: {self._at_odds(check, position, link)}"

    def _out_of_bounds(self, at_link: int, check: int) -> str:
        """Return in words what the path of one encoder fails."""
        track, unit = self.state.link if at_link else self.state.motor, self.unit
        if check == _SILENT:
            return f"no position for {track.stale} ticks, timing.stale_ticks bridges {self.limits.stale_ticks}"
        if check == _FAST:
            return f"moved by {track.step:+.2e} {unit} at once {self._doing}; {self._speeds[at_link]:.3g} {unit}/s is allowed"
        return f"moved by {track.moved:+.2e} {unit} {self._doing}; {track.travel:.2e} {unit} is allowed"

    def _at_odds(self, check: int, position: float, link: float) -> str:
        """Return in words what both paths, or the positions themselves, fail."""
        state, unit, limits = self.state, self.unit, self.limits
        if check == _STILL:
            return f"its motor side shows no motion for {STILL_S:g} s {self._doing}; brake, motor or encoder"
        motor, other = float(state.motor.moved), float(state.link.moved)
        if check == _PART_UNHEARD:
            return (
                f"link encoder: no position for {state.link.stale} ticks, and its motor side moved by "
                f"{motor - other:+.2e} {unit} {self._doing}; {state.apart:.2e} {unit} is allowed"
            )
        if check == _PART:
            return (
                f"its motor side moved by {motor:+.2e} {unit}, its link encoder by {other:+.2e} {self._doing}; "
                f"they may differ by {state.apart:.2e}: one of them is frozen, counts the wrong way, or the gear between them slips"
            )
        value, name = (position, "position") if check == _OUTSIDE else (link, "link position")
        return f"{name} {value:.4f} {unit} is outside {limits.lower:.4f} to {limits.upper:.4f} {unit}"


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

    Attributes
    ----------
    law : Law
        Of all axes at once. It may be replaced by a compiled one, which takes less time and finds the same.
    states : (n_axes,) array of WATCHED
    """

    def __init__(self, limits: Sequence[MotionLimits], scalings: Sequence[AxisScaling], clock: Clock, period_s: float) -> None:
        self.law: Law = watched_axes
        self.states = np.zeros(len(limits), WATCHED)
        self._block = self.states.view(np.uint8)
        self._axes = [
            _AxisWatch(limit, scaling, period_s, self.states[k]) for k, (limit, scaling) in enumerate(zip(limits, scalings, strict=True))
        ]
        self._clock = clock
        self._missed = 0
        self._ticks = 0  # since somebody answered

    def forget(self) -> None:
        """Mark every axis as not homed, because the counters start again."""
        for axis in self._axes:
            axis.state.homed = False

    def homed(self, axis: int) -> None:
        """Mark an axis as homed: its motor-side position is the joint's."""
        self._axes[axis].state.homed = True

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
        self._ticks += 1
        if missed != self._missed:
            self._ticks += max(0, missed - self._missed)
            self._missed = missed
        if sample.unanswered:  # the bus is late, and no axis is silent
            return ""
        ticks, self._ticks = self._ticks, 0
        found = self.law(self._block, sample.memory, ticks)
        if not found:
            return ""
        if found < 0:
            raise ValueError(f"a sample of {sample.axes} axes and a watch of {len(self._axes)}: one is longer")
        axis, check = divmod(found, len(CHECKS))
        return self._axes[axis].says(check, float(sample.position[axis]), float(sample.link_position[axis]))
