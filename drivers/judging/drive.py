"""Is a drive to be believed: it does not warn, measures the effort that it was sent, and takes as much as the machine file says."""

from __future__ import annotations

from collections import deque
from math import isfinite, nan

from drivers.canopen.cia402 import WARNING
from drivers.interface import Sample
from drivers.judging.motion_window import WINDOW_S, MotionWindow
from drivers.judging.settings import DriveJudging, Follows

LOST = 2.0
"""Multiple of the tolerance that a drive was sent, of which it measures none: it has lost its torque, and what it should hold may fall."""

UNSURE = 3.0
"""Standard deviations of a friction of unknown direction that are allowed: it may act fully either way."""


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

    Attributes
    ----------
    lag_ticks : int
        For how many ticks before the newest one the readings are in doubt too.
    follows : str
        What follows the newest finding.
    """

    def __init__(self, settings: DriveJudging, window: MotionWindow | None = None) -> None:
        self.sensor = settings.sensor
        self.follows: Follows = settings.follows
        self._settings = settings
        self._window = window
        self._statusword = 0
        self.begin()

    def begin(self) -> None:
        """Begin anew: no command is known."""
        self.lag_ticks = 0
        self._sent: deque[float] = deque(maxlen=self._settings.settling_ticks + 1)
        self._off_ticks = self._far_ticks = 0
        self._measured = self._expected = self._load_off = nan
        self._overloaded = False

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        settings = self._settings
        axis = settings.axis
        self._sent.append(float(sample.commanded[axis]))
        measured = float(sample.effort[axis])
        low, high = min(self._sent), max(self._sent)
        if low - settings.tolerance <= measured <= high + settings.tolerance:
            self._off_ticks = self._far_ticks = 0
        elif measured == measured and low == low:
            self._off_ticks += ticks
            self._measured, self._expected = measured, low if measured < low else high
            self._far_ticks = self._far_ticks + ticks if self._is_far() else 0
        self.lag_ticks, self.follows = 0, settings.follows
        overloaded = self._is_overloaded(axis)
        if self._off_ticks > settings.bridged_ticks:
            self.lag_ticks = self._off_ticks - 1
            self.follows = "stop" if self._far_ticks > settings.bridged_ticks else settings.follows
            return "effort"
        statusword = int(sample.statusword[axis])
        if statusword >= 0 and statusword & WARNING:
            self._statusword = statusword
            return "warning"
        self.lag_ticks = self._window.ticks - 1 if overloaded and self._window is not None and self._window.over else 0
        return "load" if overloaded else ""

    def _is_far(self) -> bool:
        """Whether the drive has lost its torque, or gives what it was not sent."""
        settings, lost = self._settings, abs(self._measured) <= self._settings.tolerance
        far = abs(self._measured - self._expected) > settings.stop_tolerance
        return far or (lost and isfinite(settings.stop_tolerance) and abs(self._expected) > LOST * settings.tolerance)

    def _is_overloaded(self, axis: int) -> bool:
        """Judge the window that is over; what it found stands to the end of the next one."""
        window = self._window
        if window is not None and window.over:
            off = float(window.effort_off[axis])
            allowed = self._settings.load_tolerance + UNSURE * float(window.effort_unsure[axis])
            self._overloaded, self._load_off = abs(off) > allowed, off
        return self._overloaded

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        if check == "warning":
            return f"its drive warns (statusword {self._statusword:04X}h)"
        unit = self._settings.unit
        if check == "load":
            return (
                f"its mean effort over {WINDOW_S:g} s is {self._load_off:+.3g} {unit} from what the machine file says of this motion, "
                f"{self._settings.load_tolerance:.2g} {unit} are allowed: brake, friction, load or motor differ from it"
            )
        return (
            f"its drive measures {self._measured:+.3g} {unit} where it was sent {self._expected:+.3g} {unit}; "
            f"they may differ by {self._settings.tolerance:.2g} {unit}"
        )
