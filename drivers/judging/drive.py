"""Is a drive to be believed: it does not warn, measures the effort that it was sent, and takes as much as the machine file says."""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
from numba.extending import register_jitable

from drivers.canopen.cia402 import WARNING
from drivers.interface import Sample
from drivers.judging.motion_window import WINDOW_S, MotionWindow
from drivers.judging.settings import DriveJudging, Follows
from drivers.records import Record, record_type

LOST = 2.0
"""Multiple of the tolerance that a drive was sent, of which it measures none: it has lost its torque, and what it should hold may fall."""

UNSURE = 3.0
"""Standard deviations that are allowed: of a friction of unknown direction, which may act fully either way, and of an unknown load."""

CHECKS = ("", "effort", "warning", "load")
_FINE, _EFFORT, _WARNING, _LOAD = range(4)

DRIVE = record_type(
    ("axis", "i8"),
    ("tolerance", "f8"),  # drive's unit
    ("stop_tolerance", "f8"),
    ("settling_ticks", "i8"),
    ("bridged_ticks", "i8"),
    ("window_ticks", "i8"),  # of the motion window
    # what was seen
    ("commands", "i8"),  # how many were sent, at most settling_ticks + 1
    ("newest", "i8"),  # place of the newest of them
    ("off_ticks", "i8"),
    ("far_ticks", "i8"),
    ("measured", "f8"),  # drive's unit: the last effort that was off
    ("expected", "f8"),
    ("statusword", "i8"),  # with its warning
    ("overloaded", "?"),
    ("is_lost", "?"),  # the newest finding stops the motors, whatever follows otherwise
    ("lag_ticks", "i8"),
)
"""Settings and memory of a drive's judge."""


@register_jitable
def judged_drive(drive: Record, sent: np.ndarray, answer: Record, ticks: int, window_over: bool) -> int:
    """Return which of `CHECKS` the newest sample fails, 0 when none; callable from compiled code.

    Parameters
    ----------
    drive : DRIVE
        Advanced in place.
    sent : (settling_ticks + 1 or more,) array
        The last efforts sent [drive's unit], in the order of a ring; advanced in place.
    answer : VALUES
        Of its axis.
    ticks : int
        Passed since the sample before.
    window_over : bool
        Whether this sample ended a motion window, by which `overloaded` was set.
    """
    kept = drive.settling_ticks + 1
    drive.newest = (drive.newest + 1) % kept
    sent[drive.newest] = answer.commanded
    drive.commands = min(drive.commands + 1, kept)
    low = high = sent[(drive.newest + 1 - drive.commands) % kept]
    for k in range(2 - drive.commands, 1):
        effort = sent[(drive.newest + k) % kept]
        if effort < low:
            low = effort
        if effort > high:
            high = effort
    measured = answer.effort
    if low - drive.tolerance <= measured <= high + drive.tolerance:
        drive.off_ticks = drive.far_ticks = 0
    elif measured == measured and low == low:
        drive.off_ticks += ticks
        drive.measured, drive.expected = measured, low if measured < low else high
        is_far = abs(drive.measured - drive.expected) > drive.stop_tolerance
        if abs(drive.measured) <= drive.tolerance and isfinite(drive.stop_tolerance):
            is_far = is_far or abs(drive.expected) > LOST * drive.tolerance
        drive.far_ticks = drive.far_ticks + ticks if is_far else 0
    drive.lag_ticks, drive.is_lost = 0, False
    if drive.off_ticks > drive.bridged_ticks:
        drive.lag_ticks = drive.off_ticks - 1
        drive.is_lost = drive.far_ticks > drive.bridged_ticks
        return _EFFORT
    if answer.statusword >= 0 and answer.statusword & WARNING:
        drive.statusword = answer.statusword
        return _WARNING
    drive.lag_ticks = drive.window_ticks - 1 if drive.overloaded and window_over else 0
    return _LOAD if drive.overloaded else _FINE


class DriveJudge:
    """Judges warning bit, measured effort and load of one axis's drive.

    A drive follows its command within a settling time, so the effort that it measures lies between the least and the greatest command of
    that time. A power stage that gives more, less, or something else is seen here before the axis departs from its reference; one that
    gives none, or is far off, stops the motors in any case.

    Parameters
    ----------
    settings : DriveJudging
    window : MotionWindow, optional
        Of the machine, stepped before this; without one the load is not judged.
    state : (1,) array of DRIVE, optional
        Its memory.
    sent : (settling_ticks + 1 or more,) array, optional
        Memory of what it was sent.
    """

    checks = CHECKS

    def __init__(
        self,
        settings: DriveJudging,
        window: MotionWindow | None = None,
        state: np.ndarray | None = None,
        sent: np.ndarray | None = None,
    ) -> None:
        self.sensor = settings.sensor
        self._settings = settings
        self._window = window
        self._state = (np.zeros(1, DRIVE) if state is None else state)[0]
        self._sent = np.full(settings.settling_ticks + 1, nan) if sent is None else sent
        self.begin()

    def begin(self) -> None:
        """Begin anew: no command is known."""
        state, settings = self._state, self._settings
        state.axis, state.tolerance, state.stop_tolerance = settings.axis, settings.tolerance, settings.stop_tolerance
        state.settling_ticks, state.bridged_ticks = settings.settling_ticks, settings.bridged_ticks
        state.window_ticks = 1 if self._window is None else self._window.ticks
        state.commands, state.newest = 0, -1
        state.off_ticks = state.far_ticks = state.lag_ticks = 0
        state.measured = state.expected = self._load_off = self._allowed = nan
        state.overloaded = state.is_lost = False

    @property
    def lag_ticks(self) -> int:
        """For how many ticks before the newest one the readings are in doubt too."""
        return int(self._state.lag_ticks)

    @property
    def follows(self) -> Follows:
        """What follows the newest finding."""
        return "stop" if self._state.is_lost else self._settings.follows

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        axis, is_over = self._settings.axis, self._window is not None and self._window.over
        if is_over:
            self.take_window()
        answer = sample.values[axis]
        return CHECKS[judged_drive(self._state, self._sent, answer, ticks, is_over)]

    def take_window(self) -> None:
        """Judge the load by the window that is over; what is found stands to the end of the next one."""
        assert self._window is not None
        axis = self._settings.axis
        self._load_off = float(self._window.effort_off[axis])
        self._allowed = self._settings.load_tolerance + UNSURE * float(self._window.effort_unsure[axis])
        self._state.overloaded = abs(self._load_off) > self._allowed

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        state = self._state
        if check == "warning":
            return f"its drive warns (statusword {int(state.statusword):04X}h)"
        unit = self._settings.unit
        if check == "load":
            return (
                f"its mean effort over {WINDOW_S:g} s is {self._load_off:+.3g} {unit} from what the machine file says of this motion, "
                f"{self._allowed:.2g} {unit} are allowed: brake, friction, load or motor differ from it"
            )
        return (
            f"its drive measures {state.measured:+.3g} {unit} where it was sent {state.expected:+.3g} {unit}; "
            f"they may differ by {self._settings.tolerance:.2g} {unit}"
        )
