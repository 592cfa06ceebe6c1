"""Is an IMU to be believed: its packets come, at their rate and undamaged, and hold numbers that a living sensor gives."""

from __future__ import annotations

from math import hypot, inf, isfinite, nan

import numpy as np
from numba.extending import register_jitable

from drivers.interface import Sample
from drivers.judging.motion_window import WINDOW_S as MOTION_WINDOW_S
from drivers.judging.motion_window import MotionWindow
from drivers.judging.settings import ImuJudging
from drivers.records import Record, record_type

WINDOW_S = 1.0
"""Time over which packets are counted: long against a pause of the host, short against a run."""

LATE_PERIODS = 1.5
"""Periods, of ticks or of packets, whichever is longer, by which a reading may be older than the youngest one so far: jitter of its line
and the phase of a sensor that runs on its own clock."""
CLOCK_DRIFT = 2e-4
"""By which the IMU's clock and the bench's may differ: twice what quartzes without compensation do."""

CHANNELS = ("x", "y", "z", "rate x", "rate y", "rate z")
CHECKS = ("", "fault", "garbage", "age", "number", "range", "frozen", "rate", "late", "specific force", "angular rate")
_FINE, _FAULT, _GARBAGE, _AGE, _NUMBER, _RANGE, _FROZEN, _RATE, _LATE, _FORCE, _TURN = range(11)

PACKETS = record_type(
    ("is_triggered", "?"),
    ("period_s", "f8"),
    ("window", "i8"),  # ticks
    ("expected", "f8"),  # readings a tick: a row holds one
    ("rate_tolerance", "f8"),
    ("age_s", "f8"),
    ("late_s", "f8"),
    ("damaged_most", "i8"),
    ("full_scale", "f8", 6),
    ("frozen_packets", "i8", 6),
    ("motion_ticks", "i8"),  # of the motion window
    # what was seen
    ("silent", "i8"),
    ("ticks", "i8"),
    ("came", "i8"),
    ("came_before", "i8"),
    ("is_wrong_rate", "?"),
    ("damaged_before", "i8"),
    ("damaged", "i8"),
    ("garbage_ticks", "i8"),
    ("values", "f8", 6),
    ("equal", "i8", 6),
    ("channel", "i8"),
    ("elapsed_s", "f8"),
    ("youngest_s", "f8"),  # age of a reading, up to a constant
    ("older_s", "f8"),
    ("late_ticks", "i8"),
    ("departed", "i8"),  # of CHECKS, by the newest motion window
    ("lag_ticks", "i8"),
)
"""Settings and memory of an IMU's judge."""


@register_jitable
def _is_garbage(packets: Record, damaged: int, ticks: int) -> bool:
    """Tell whether more messages than allowed came damaged within this window or the one before."""
    if packets.damaged_before < 0 or damaged < packets.damaged_before:  # the first, or of a line that was opened again
        packets.damaged_before = damaged
    left = packets.garbage_ticks - ticks
    packets.garbage_ticks = left if left > 0 else 0
    if damaged - packets.damaged_before > packets.damaged_most:
        packets.damaged = damaged - packets.damaged_before
        packets.garbage_ticks = packets.window
    return bool(packets.garbage_ticks > 0)


@register_jitable
def _counted(packets: Record, has_come: bool, damaged: int, ticks: int) -> None:
    """Count the readings of a window, and judge the one that is over; damaged messages are counted from its end on."""
    packets.came += 1 if has_come else 0
    packets.ticks += ticks
    if packets.ticks >= packets.window:
        wanted = packets.expected * packets.ticks
        packets.came_before = packets.came
        # one reading more or less is the phase of a sensor that runs on its own clock
        packets.is_wrong_rate = abs(packets.came - wanted) > packets.rate_tolerance * wanted + 1.0
        packets.ticks = packets.came = 0
        packets.damaged_before = damaged


@register_jitable
def _is_late(packets: Record, has_come: bool, lateness_s: float, time_s: float, ticks: int) -> bool:
    """Tell whether readings have come too old for longer than they may be missing. Lost ticks begin the comparison anew."""
    packets.elapsed_s += packets.period_s
    if ticks != 1:
        packets.youngest_s = inf
    if has_come:
        age_s = packets.elapsed_s + lateness_s - time_s
        youngest_s = packets.youngest_s + CLOCK_DRIFT * packets.period_s
        packets.youngest_s = age_s if age_s < youngest_s else youngest_s
        packets.older_s = age_s - packets.youngest_s
        packets.late_ticks = packets.late_ticks + 1 if packets.older_s > packets.late_s else 0
    return bool(packets.late_ticks * packets.period_s > packets.age_s)


@register_jitable
def _judged_values(packets: Record, values: np.ndarray) -> int:
    """Return which check the numbers of a reading (6,) fail, 0 when none."""
    found = _FINE
    for channel in range(6):
        value = values[channel]
        packets.equal[channel] = packets.equal[channel] + 1 if value == packets.values[channel] else 1
        packets.values[channel] = value
        if found != _FINE:
            continue
        if not isfinite(value):
            found = _NUMBER
        elif abs(value) >= packets.full_scale[channel]:
            found = _RANGE
        elif 0 < packets.frozen_packets[channel] <= packets.equal[channel]:
            found = _FROZEN
            packets.lag_ticks = packets.frozen_packets[channel] - 1
        if found != _FINE:
            packets.channel = channel
    return found


@register_jitable
def judged_imu(
    packets: Record,
    values: np.ndarray,
    counter: int,
    time_s: float,
    damaged: int,
    has_fault: bool,
    lateness_s: float,
    ticks: int,
    window_over: bool,
) -> int:
    """Return which of `CHECKS` the newest sample fails, 0 when none; callable from compiled code.

    Parameters
    ----------
    packets : PACKETS
        Advanced in place.
    values : (6,) array
        Specific force [m/s^2] and angular rate [rad/s].
    counter : int
        Of the reading; negative when none has come.
    time_s : float
        Of the IMU's clock.
    damaged : int
        Messages that failed their checksum so far.
    has_fault : bool
        Whether the IMU, or its line, has reported a fault.
    lateness_s : float
        Of the SYNC.
    ticks : int
        Passed since the sample before.
    window_over : bool
        Whether this sample ended a motion window, by which `departed` was set.
    """
    has_come, passed = counter >= 0, ticks
    ticks = 1 if packets.is_triggered else ticks
    packets.silent = 0 if has_come else packets.silent + ticks
    is_garbage, counted = _is_garbage(packets, damaged, ticks), packets.ticks + ticks
    _counted(packets, has_come, damaged, ticks)
    packets.lag_ticks = 0
    is_late = _is_late(packets, has_come, lateness_s, time_s, passed)
    if has_fault:
        return _FAULT
    if is_garbage:
        packets.lag_ticks = counted
        return _GARBAGE
    if packets.silent * packets.period_s > packets.age_s:
        packets.lag_ticks = packets.silent - 1
        return _AGE
    if has_come:
        found = _judged_values(packets, values)
        if found != _FINE:
            return found
    if packets.is_wrong_rate:
        packets.lag_ticks = packets.window
        return _RATE
    if is_late:
        return _LATE
    packets.lag_ticks = packets.motion_ticks - 1 if packets.departed != _FINE and window_over else 0
    return int(packets.departed)


class ImuJudge:
    """Judges the packets of one IMU.

    Parameters
    ----------
    settings : ImuJudging
    window : MotionWindow, optional
        Of the machine, stepped before this; without one the readings are not compared with the motion.
    state : (1,) array of PACKETS, optional
        Its memory.
    """

    checks = CHECKS

    def __init__(self, settings: ImuJudging, window: MotionWindow | None = None, state: np.ndarray | None = None) -> None:
        self.sensor, self.follows = settings.sensor, settings.follows
        self._settings = settings
        self._motion = window
        self._state = (np.zeros(1, PACKETS) if state is None else state)[0]
        self.begin()

    def begin(self) -> None:
        """Begin anew: no packet is known."""
        state, settings = self._state, self._settings
        state.is_triggered, state.period_s = settings.triggered, settings.period_s
        state.window = max(1, round(WINDOW_S / settings.period_s))
        state.expected = min(settings.rate_Hz * settings.period_s, 1.0)
        state.rate_tolerance, state.age_s, state.damaged_most = settings.rate_tolerance, settings.age_s, settings.damaged_per_s
        state.late_s = LATE_PERIODS * max(settings.period_s, 1.0 / settings.rate_Hz)
        state.full_scale[:], state.frozen_packets[:] = settings.full_scale, settings.frozen_packets
        state.motion_ticks = 1 if self._motion is None else self._motion.ticks
        state.silent = state.ticks = state.came = state.came_before = state.damaged = state.garbage_ticks = state.channel = 0
        state.late_ticks = state.lag_ticks = 0
        state.damaged_before = -1
        state.is_wrong_rate = False
        state.values[:], state.equal[:] = nan, 1
        state.elapsed_s = state.older_s = 0.0
        state.youngest_s = inf
        state.departed = _FINE
        self._fault = self._departed_words = ""

    @property
    def lag_ticks(self) -> int:
        """For how many ticks before the newest one the readings are in doubt too."""
        return int(self._state.lag_ticks)

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        is_over = self._motion is not None and self._motion.over
        if is_over:
            self.take_window()
        self.take_fault(sample)
        found = judged_imu(
            self._state,
            sample.imu,
            sample.imu_counter,
            sample.imu_time_s,
            sample.imu_damaged,
            bool(sample.imu_fault),
            sample.lateness_s,
            ticks,
            is_over,
        )
        return CHECKS[found]

    def take_fault(self, sample: Sample) -> None:
        """Keep the words of a fault that the IMU has reported."""
        self._fault = sample.imu_fault or self._fault

    def take_window(self) -> None:
        """Judge the window that is over against the motion; what is found stands to the end of the next one."""
        assert self._motion is not None
        settings, self._state.departed = self._settings, _FINE
        for check, channels, allowed, unit in (
            (_FORCE, self._motion.imu_off[:3], settings.force_tolerance, "m/s^2"),
            (_TURN, self._motion.imu_off[3:], settings.turn_tolerance, "rad/s"),
        ):
            off = hypot(*channels.tolist())
            if off > allowed and self._state.departed == _FINE:
                self._state.departed = check
                self._departed_words = (
                    f"its mean {CHECKS[check]} over {MOTION_WINDOW_S:g} s is {off:.2g} {unit} from what the motion of the axes makes of "
                    f"it, {allowed:.2g} {unit} are allowed"
                )

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        settings, state = self._settings, self._state
        if check == "fault":
            return self._fault.partition(": ")[2] or self._fault  # the line's name stands before it
        if check == "garbage":
            return f"{int(state.damaged)} damaged messages within {WINDOW_S:g} s, {settings.damaged_per_s} are allowed"
        if check == "age":
            return f"no packet for more than {settings.age_s:.3f} s"
        if check == "rate":
            packets, wanted = int(state.came_before), float(state.expected * state.window)
            return f"{packets} packets within {WINDOW_S:g} s, {wanted:.0f} are its rate and {settings.rate_tolerance:.0%} the tolerance"
        if check == "late":
            older_s, late_s = float(state.older_s), float(state.late_s)
            return f"its readings are {older_s * 1e3:.1f} ms older than at first, {late_s * 1e3:.1f} ms are allowed"
        if check in ("specific force", "angular rate"):
            return self._departed_words
        channel = int(state.channel)
        name, value = CHANNELS[channel], float(state.values[channel])
        if check == "number":
            return f"{name} is {value}, no number"
        if check == "range":
            return f"{name} reads {value:.4g}, its full scale is {settings.full_scale[channel]:.4g}"
        return f"{name} has not changed for {settings.frozen_packets[channel]} packets; noise makes that impossible"
