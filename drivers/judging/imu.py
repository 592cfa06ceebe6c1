"""Is an IMU to be believed: its packets come, at their rate and undamaged, and hold numbers that a living sensor gives."""

from __future__ import annotations

from math import hypot, inf, isfinite

from drivers.interface import Sample
from drivers.judging.motion_window import WINDOW_S as MOTION_WINDOW_S
from drivers.judging.motion_window import MotionWindow
from drivers.judging.settings import ImuJudging

WINDOW_S = 1.0
"""Time over which packets are counted: long against a pause of the host, short against a run."""

LATE_PERIODS = 1.5
"""Periods, of ticks or of packets, whichever is longer, by which a reading may be older than the youngest one so far: jitter of its line
and the phase of a sensor that runs on its own clock."""
CLOCK_DRIFT = 2e-4
"""By which the IMU's clock and the bench's may differ: twice what quartzes without compensation do."""

CHANNELS = ("x", "y", "z", "rate x", "rate y", "rate z")


class ImuJudge:
    """Judges the packets of one IMU.

    Parameters
    ----------
    settings : ImuJudging
    window : MotionWindow, optional
        Of the machine, stepped before this; without one the readings are not compared with the motion.

    Attributes
    ----------
    lag_ticks : int
        For how many ticks before the newest one the readings are in doubt too.
    """

    def __init__(self, settings: ImuJudging, window: MotionWindow | None = None) -> None:
        self.sensor, self.follows = settings.sensor, settings.follows
        self._settings = settings
        self._window = max(1, round(WINDOW_S / settings.period_s))
        self._motion = window
        self._late_s = LATE_PERIODS * max(settings.period_s, 1.0 / settings.rate_Hz)
        self._expected = min(settings.rate_Hz * settings.period_s, 1.0)  # readings a tick: a row holds one
        self.begin()

    def begin(self) -> None:
        """Begin anew: no packet is known."""
        self.lag_ticks = 0
        self._silent = 0
        self._ticks = self._came = 0
        self._wrong_rate = ""
        self._came_before = 0
        self._damaged_before = -1
        self._garbage_ticks = 0
        self._damaged = 0
        self._values = [float("nan")] * 6
        self._equal = [1] * 6
        self._channel = 0
        self._words = ""
        self._elapsed_s = 0.0
        self._youngest_s = inf  # age of a reading, up to a constant
        self._age_s, self._late_ticks = 0.0, 0
        self._departed = self._departed_words = ""

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        came, passed = sample.imu_counter >= 0, ticks
        ticks = 1 if self._settings.triggered else ticks
        self._silent = 0 if came else self._silent + ticks
        garbage, counted = self._count_damaged(sample.imu_damaged, ticks), self._ticks + ticks
        rate = self._count(came, sample.imu_damaged, ticks)
        self.lag_ticks = 0
        late, departed = self._is_late(sample, came, passed), self._departs()
        if sample.imu_fault:
            self._words = sample.imu_fault
            return "fault"
        if garbage:
            self.lag_ticks = counted
            return "garbage"
        settings = self._settings
        if self._silent * settings.period_s > settings.age_s:
            self.lag_ticks = self._silent - 1
            return "age"
        if came and (check := self._value(sample.imu.tolist())):
            return check
        if rate:
            self.lag_ticks = self._window
            return rate
        if late:
            return "late"
        self.lag_ticks = self._motion.ticks - 1 if departed and self._motion is not None and self._motion.over else 0
        return departed

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        settings = self._settings
        if check == "fault":
            return self._words.partition(": ")[2] or self._words  # the line's name stands before it
        if check == "garbage":
            return f"{self._damaged} damaged messages within {WINDOW_S:g} s, {settings.damaged_per_s} are allowed"
        if check == "age":
            return f"no packet for more than {settings.age_s:.3f} s"
        if check == "rate":
            packets, wanted = self._came_before, self._expected * self._window
            return f"{packets} packets within {WINDOW_S:g} s, {wanted:.0f} are its rate and {settings.rate_tolerance:.0%} the tolerance"
        channel, value = CHANNELS[self._channel], self._values[self._channel]
        if check == "late":
            return f"its readings are {self._age_s * 1e3:.1f} ms older than at first, {self._late_s * 1e3:.1f} ms are allowed"
        if check in ("specific force", "angular rate"):
            return self._departed_words
        if check == "number":
            return f"{channel} is {value}, no number"
        if check == "range":
            return f"{channel} reads {value:.4g}, its full scale is {settings.full_scale[self._channel]:.4g}"
        return f"{channel} has not changed for {settings.frozen_packets[self._channel]} packets; noise makes that impossible"

    def _value(self, values: list[float]) -> str:
        settings, before, equal = self._settings, self._values, self._equal
        found = ""
        for channel, value in enumerate(values):
            equal[channel] = equal[channel] + 1 if value == before[channel] else 1
            if found:
                continue
            if not isfinite(value):
                found = "number"
            elif abs(value) >= settings.full_scale[channel]:
                found = "range"
            elif 0 < settings.frozen_packets[channel] <= equal[channel]:
                found = "frozen"
                self.lag_ticks = settings.frozen_packets[channel] - 1
            if found:
                self._channel = channel
        self._values = values
        return found

    def _is_late(self, sample: Sample, came: bool, ticks: int) -> bool:
        """Tell whether readings have come too old for longer than they may be missing. Lost ticks begin the comparison anew."""
        self._elapsed_s += self._settings.period_s
        if ticks != 1:
            self._youngest_s = inf
        if came:
            age_s = self._elapsed_s + sample.lateness_s - sample.imu_time_s
            self._youngest_s = min(self._youngest_s + CLOCK_DRIFT * self._settings.period_s, age_s)
            self._age_s = age_s - self._youngest_s
            self._late_ticks = self._late_ticks + 1 if self._age_s > self._late_s else 0
        return self._late_ticks * self._settings.period_s > self._settings.age_s

    def _departs(self) -> str:
        """Judge the window that is over against the motion; what it found stands to the end of the next one."""
        window, settings = self._motion, self._settings
        if window is None or not window.over:
            return self._departed
        self._departed = ""
        for name, channels, allowed, unit in (
            ("specific force", window.imu_off[:3], settings.force_tolerance, "m/s^2"),
            ("angular rate", window.imu_off[3:], settings.turn_tolerance, "rad/s"),
        ):
            off = hypot(*channels.tolist())
            if off > allowed and not self._departed:
                self._departed = name
                self._departed_words = (
                    f"its mean {name} over {MOTION_WINDOW_S:g} s is {off:.2g} {unit} from what the motion of the axes makes of it, "
                    f"{allowed:.2g} {unit} are allowed"
                )
        return self._departed

    def _count(self, came: bool, damaged: int, ticks: int) -> str:
        """Count the readings of a window, and judge the one that is over; damaged messages are counted from its end on."""
        self._came += came
        self._ticks += ticks
        if self._ticks >= self._window:
            wanted = self._expected * self._ticks
            self._came_before = self._came
            # one reading more or less is the phase of a sensor that runs on its own clock
            self._wrong_rate = "rate" if abs(self._came - wanted) > self._settings.rate_tolerance * wanted + 1.0 else ""
            self._ticks = self._came = 0
            self._damaged_before = damaged
        return self._wrong_rate

    def _count_damaged(self, damaged: int, ticks: int) -> bool:
        """Tell whether more messages than allowed came damaged within this window or the one before."""
        if self._damaged_before < 0 or damaged < self._damaged_before:  # the first, or of a line that was opened again
            self._damaged_before = damaged
        self._garbage_ticks = max(0, self._garbage_ticks - ticks)
        if damaged - self._damaged_before > self._settings.damaged_per_s:
            self._damaged = damaged - self._damaged_before
            self._garbage_ticks = self._window
        return self._garbage_ticks > 0
