"""Are an axis's two encoders to be believed: neither jumps, and they do not part beyond what the spring between them carries."""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
from numba.extending import register_jitable

from drivers.interface import Sample
from drivers.judging.settings import ENCODERS_WINDOW_S, EncoderJudging
from drivers.records import Record, record_type

GROWING = 4
"""Windows in a row in which a difference must grow to count as a drift. What friction and play leave ends soon after the reversal."""

COUNTS = 4.0
"""Counts by which the second difference of a sound encoder can be off: twice the two that rounding its three readings makes."""

CHECKS = ("", "jump", "drift", "apart", "silent")
_FINE, _JUMP, _DRIFT, _APART, _SILENT = range(5)
NAMES = ("motor side", "link encoder")

PATH = record_type(
    ("acceleration", "f8"),  # greatest second difference of a path at even speed [rad or m]
    ("second", "f8"),  # newest second difference
    ("allowed", "f8"),
    ("last", "f8"),
    ("before", "f8"),
    ("late", "f8"),  # lateness [s] of the SYNCs of both
    ("late_before", "f8"),
)
"""Path of one encoder: an acceleration makes a second difference of itself times the period squared, a step makes any."""

PAIR = record_type(
    ("axis", "i8"),
    ("has_link", "?"),
    ("period_s", "f8"),
    ("window", "i8"),  # ticks
    ("stale_ticks", "i8"),
    ("tolerance", "f8"),
    ("drift", "f8"),
    ("growth", "f8"),
    ("compliance", "f8"),
    ("inertia", "f8"),
    ("damping", "f8"),
    ("effort_scale", "f8"),
    # what was seen
    ("motor", PATH),
    ("link", PATH),
    ("found", "i8"),  # of CHECKS; it stands
    ("at_link", "?"),  # the encoder that jumped is the link's
    ("amount", "f8"),  # of what was found: second difference, growth a window, or distance [rad or m]
    ("allowed", "f8"),  # at that moment
    ("departed", "f8"),  # from the first window's difference
    ("silent", "i8"),
    ("position", "f8"),
    ("speed", "f8"),
    ("ticks", "i8"),
    ("summed", "i8"),
    ("total", "f8"),
    ("first", "f8"),
    ("apart", "f8"),
    ("growing", "i8"),
    ("lag_ticks", "i8"),
)
"""Settings and memory of the judge of an axis's encoders."""


@register_jitable
def forgotten_path(path: Record) -> None:
    """Begin a path anew, or after a gap; callable from compiled code."""
    path.second = path.last = path.before = nan
    path.allowed = path.acceleration
    path.late = path.late_before = 0.0


@register_jitable
def jumped(path: Record, position: float, lateness_s: float, period_s: float) -> bool:
    """Take the newest position in; return whether no acceleration makes its step. Callable from compiled code."""
    if not isfinite(position):
        forgotten_path(path)
        return False
    path.second = position - 2.0 * path.last + path.before
    late = abs(lateness_s) + 2.0 * abs(path.late) + abs(path.late_before)  # a late SYNC latches a moving axis further on
    newest, before = abs(position - path.last), abs(path.last - path.before)
    speed = (before if before > newest else newest) / period_s
    path.allowed = path.acceleration + speed * late
    path.before, path.last = path.last, position
    path.late_before, path.late = path.late, lateness_s
    return bool(abs(path.second) > path.allowed)  # False while there are no three positions


@register_jitable
def judged_difference(pair: Record, apart: float) -> None:
    """Judge the mean difference of both encoders over a window [rad or m]; callable from compiled code."""
    if not isfinite(pair.first):
        pair.first = pair.apart = apart
    step, departed = apart - pair.apart, apart - pair.first
    pair.apart = apart
    pair.growing = pair.growing + 1 if step * departed > 0.0 and abs(step) > pair.growth else 0
    if pair.found != _FINE:
        return
    if pair.growing >= GROWING and abs(departed) > pair.drift:
        pair.found, pair.amount, pair.departed = _DRIFT, step, departed
        pair.lag_ticks = pair.growing * pair.window
    elif abs(apart) > pair.tolerance:
        pair.found, pair.amount = _APART, apart
        pair.lag_ticks = pair.window


@register_jitable
def _compare(pair: Record, motor: float, link: float, effort: float, ticks: int) -> None:
    """Average what the difference of both encoders is beyond the windup, and judge every window that is over."""
    speed = (motor - pair.position) / pair.period_s if ticks == 1 else nan
    acceleration = (speed - pair.speed) / pair.period_s
    pair.position, pair.speed = motor, speed
    windup = 0.0
    if pair.compliance > 0.0:
        load = pair.inertia * acceleration + pair.damping * speed - pair.effort_scale * effort
        windup = pair.compliance * load
    apart = link - motor - windup
    if isfinite(apart):
        pair.total += apart
        pair.summed += 1
    pair.ticks += ticks
    if pair.ticks >= pair.window:
        if 2 * pair.summed >= pair.window:
            judged_difference(pair, pair.total / pair.summed)
        pair.ticks = pair.summed = 0
        pair.total = 0.0


@register_jitable
def judged_encoders(pair: Record, answer: Record, lateness_s: float, ticks: int) -> int:
    """Return which of `CHECKS` the newest sample fails, 0 when none; callable from compiled code.

    Parameters
    ----------
    pair : PAIR
        Advanced in place.
    answer : VALUES
        Of its axis.
    lateness_s : float
        Of the SYNC.
    ticks : int
        Passed since the sample before.
    """
    pair.lag_ticks = 0
    if ticks != 1:
        forgotten_path(pair.motor)
        forgotten_path(pair.link)
        pair.speed = nan
    if jumped(pair.motor, answer.position, lateness_s, pair.period_s) and pair.found == _FINE:
        pair.found, pair.at_link, pair.amount, pair.allowed = _JUMP, False, pair.motor.second, pair.motor.allowed
    if not pair.has_link:
        return int(pair.found)
    if jumped(pair.link, answer.link_position, lateness_s, pair.period_s) and pair.found == _FINE:
        pair.found, pair.at_link, pair.amount, pair.allowed = _JUMP, True, pair.link.second, pair.link.allowed
    _compare(pair, answer.position, answer.link_position, answer.effort, ticks)
    pair.silent = 0 if isfinite(answer.link_position) else pair.silent + ticks
    if pair.found == _FINE and pair.silent > pair.stale_ticks:
        pair.lag_ticks = pair.silent - 1
        return _SILENT
    return int(pair.found)


class EncoderJudge:
    """Judges motor side and link encoder of one axis.

    A finding other than silence stands to the end: a counter that has lost counts does not find them again.

    Parameters
    ----------
    settings : EncoderJudging
    state : (1,) array of PAIR, optional
        Its memory.
    """

    checks = CHECKS

    def __init__(self, settings: EncoderJudging, state: np.ndarray | None = None) -> None:
        self.sensor, self.follows = settings.sensor, settings.follows
        self._settings = settings
        self._state = (np.zeros(1, PAIR) if state is None else state)[0]
        self.begin()

    def begin(self) -> None:
        """Begin anew, with both encoders as they are."""
        state, settings = self._state, self._settings
        state.axis, state.has_link, state.period_s = settings.axis, settings.link_resolution > 0.0, settings.period_s
        state.window, state.stale_ticks = max(1, round(ENCODERS_WINDOW_S / settings.period_s)), settings.stale_ticks
        state.tolerance, state.drift, state.growth = settings.tolerance, settings.drift, settings.growth
        state.compliance, state.inertia = settings.compliance, settings.inertia
        state.damping, state.effort_scale = settings.damping, settings.effort_scale
        for path, resolution, acceleration in (
            (state.motor, settings.motor_resolution, settings.motor_acceleration),
            (state.link, settings.link_resolution, settings.link_acceleration),
        ):
            path.acceleration = acceleration * settings.period_s**2 + COUNTS * resolution
            forgotten_path(path)
        state.found = _FINE
        state.at_link = False
        state.silent = state.ticks = state.summed = state.growing = state.lag_ticks = 0
        state.total = 0.0
        state.position = state.speed = state.first = state.apart = state.amount = state.allowed = state.departed = nan

    @property
    def lag_ticks(self) -> int:
        """For how many ticks before the newest one the readings are in doubt too."""
        return int(self._state.lag_ticks)

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        axis = self._settings.axis
        answer = sample.values[axis]
        return CHECKS[judged_encoders(self._state, answer, sample.lateness_s, ticks)]

    def finish(self) -> str:
        """Judge the window that a run's end cuts off, where at least half of it is there; return which check fails, or ''."""
        state = self._state
        if 2 * state.summed >= state.window:
            judged_difference(state, state.total / state.summed)
            state.ticks = state.summed = 0
            state.total = 0.0
        return CHECKS[state.found]

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        state, settings = self._state, self._settings
        if check == "silent":
            return f"its link encoder has sent nothing for more than {settings.stale_ticks} ticks"
        amount = float(state.amount)
        if check == "jump":
            resolution = settings.link_resolution if state.at_link else settings.motor_resolution
            counts, allowed = amount / resolution, float(state.allowed) / resolution
            return f"its {NAMES[int(state.at_link)]} jumped by {counts:+.0f} counts between two samples; motion makes at most {allowed:.0f}"
        if check == "drift":
            return (
                f"its link encoder has departed from the motor side by {float(state.departed):+.2e} {settings.unit} and goes on at "
                f"{amount / ENCODERS_WINDOW_S:+.1e} {settings.unit}/s; {settings.drift:.2e} are allowed: one of them drifts"
            )
        return (
            f"its link encoder stands {amount:+.2e} {settings.unit} from where motor side and load put it; "
            f"{settings.tolerance:.2e} are allowed"
        )
