"""All sensors of a machine, judged at every sample: marks for the row, findings for the recording, a reason to stop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numba.extending import register_jitable

from drivers.interface import Sample
from drivers.judging.drive import DRIVE, DriveJudge, judged_drive
from drivers.judging.encoders import PAIR, EncoderJudge, judged_encoders
from drivers.judging.imu import PACKETS, ImuJudge, judged_imu
from drivers.judging.motion_window import Average, MotionWindow, average
from drivers.judging.settings import Follows, JudgingSettings
from drivers.judging.temperature import THERMOMETER, TemperatureJudge, judged_temperature
from drivers.sample_memory import imus_in, values_in

MOST_FINDINGS = 64
"""Findings kept, a sensor and a check each; there are fewer pairs on a machine of six axes."""


class Memory(NamedTuple):
    """What all judges of a machine know, one array a kind, as compiled code takes it."""

    imus: np.ndarray  # (0 or 1,) PACKETS
    pairs: np.ndarray  # (encoder pairs,) PAIR
    thermometers: np.ndarray  # THERMOMETER
    drives: np.ndarray  # DRIVE
    sent: np.ndarray  # (drives, commands) efforts, drive's unit
    found: np.ndarray  # (judges,) which of its checks each failed last, 0 when none


_PARTS = len(Memory._fields)


@register_jitable
def memory_in(block: np.ndarray) -> Memory:
    """Return what all judges know as views of the one block of bytes in which it lies; callable from compiled code."""
    at = block[: 8 * (_PARTS + 2)].view(np.int64)  # where each part begins, where the last ends, and how many efforts of a drive are kept
    return Memory(
        block[at[0] : at[1]].view(PACKETS),
        block[at[1] : at[2]].view(PAIR),
        block[at[2] : at[3]].view(THERMOMETER),
        block[at[3] : at[4]].view(DRIVE),
        block[at[4] : at[5]].view(np.float64).reshape((at[5] - at[4]) // (8 * at[7]), at[7]),
        block[at[5] : at[6]].view(np.int64),
    )


def _block_for(imus: int, pairs: int, thermometers: int, drives: int, commands: int) -> np.ndarray:
    """Return a block of memory for so many judges, which keep so many efforts of each drive."""
    floats, judges = 8 * drives * commands, imus + pairs + thermometers + drives
    sizes = imus * PACKETS.itemsize, pairs * PAIR.itemsize, thermometers * THERMOMETER.itemsize, drives * DRIVE.itemsize, floats, 8 * judges
    at = 8 * (_PARTS + 2) + np.cumsum((0, *sizes))
    block = np.zeros(at[-1], np.uint8)
    block[: 8 * (_PARTS + 2)].view(np.int64)[:] = *at, commands
    memory_in(block).sent[:] = np.nan
    return block


Law = Callable[[np.ndarray, np.ndarray, int, float, int, bool, float, float, int, bool, bool], bool]
"""`judged`, or the same compiled."""


def judged(
    block: np.ndarray,
    sample: np.ndarray,
    imu_counter: int,
    imu_time_s: float,
    imu_damaged: int,
    has_imu_fault: bool,
    lateness_s: float,
    io_age_s: float,
    ticks: int,
    window_over: bool,
    led: bool,
) -> bool:
    """Judge a sample by all laws, in the order of `Memory.found`, which is overwritten; return whether any finds something.

    Parameters
    ----------
    block, sample : arrays of bytes
        As `memory_in` and `drivers.sample_memory.values_in` take them.
    imu_counter, imu_time_s, imu_damaged, has_imu_fault, lateness_s, io_age_s
        See `Sample`.
    ticks : int
        Passed since the sample before.
    window_over : bool
        Whether this sample ended a motion window.
    led : bool
        Whether all axes are led; otherwise only thermometers are judged.
    """
    memory = memory_in(block)
    found, values, imu = memory.found, values_in(sample), imus_in(sample)[:6]
    place, any_found = 0, False
    for k in range(len(memory.imus)):
        if led:
            found[place] = judged_imu(
                memory.imus[k], imu, imu_counter, imu_time_s, imu_damaged, has_imu_fault, lateness_s, ticks, window_over
            )
        any_found = any_found or found[place] != 0
        place += 1
    for k in range(len(memory.pairs)):
        pair = memory.pairs[k]
        if led:
            found[place] = judged_encoders(pair, values[pair.axis], lateness_s, ticks)
        any_found = any_found or found[place] != 0
        place += 1
    for k in range(len(memory.thermometers)):
        thermometer = memory.thermometers[k]
        found[place] = judged_temperature(thermometer, values[thermometer.axis].temperature_degC, io_age_s, ticks)
        any_found = any_found or found[place] != 0
        place += 1
    for k in range(len(memory.drives)):
        drive = memory.drives[k]
        if led:
            found[place] = judged_drive(drive, memory.sent[k], values[drive.axis], ticks, window_over)
        any_found = any_found or found[place] != 0
        place += 1
    return any_found


class Judge(Protocol):
    """One sensor's judge."""

    sensor: str

    @property
    def checks(self) -> Sequence[str]:
        """What it may find, in words of the recording; the first is nothing."""

    @property
    def follows(self) -> Follows:
        """What follows the newest finding."""

    @property
    def lag_ticks(self) -> int:
        """For how many ticks before the newest one the readings are in doubt too."""

    def begin(self) -> None:
        """Forget what was seen."""

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none."""

    def says(self, check: str) -> str:
        """Return a failed check in words."""


@dataclass
class Finding:
    """One check that one sensor failed, over all rows in which it did."""

    sensor: str
    check: str
    says: str  # when it was first seen
    follows: Follows
    since_s: float  # from when on the readings are in doubt: before the first row that is marked
    first_s: float  # time of the first row that is marked
    last_s: float
    rows: int = 0  # how many are marked


class SensorJudge:
    """Judges every sensor of a machine.

    Parameters
    ----------
    settings : JudgingSettings
    period_s : float
        Between ticks.
    noticed : callable, optional
        Called with time, sensor, check and words when a check begins to fail, and with no words when it ends.
    law : Law, optional
        Of all judges at once: a compiled one takes less time and finds the same.
    average : Average, optional
        Of a motion window: likewise.

    Attributes
    ----------
    sensors : tuple of str
        What is judged, in the order of the bits of `marks`.
    marks : int
        A bit per sensor that is not to be believed at the newest sample.
    """

    def __init__(
        self,
        settings: JudgingSettings,
        period_s: float,
        noticed: Callable[[float, str, str, str], None] | None = None,
        law: Law = judged,
        average: Average = average,
    ) -> None:
        axes = len(settings.drives)
        window = self._window = None if settings.expects is None else MotionWindow(settings.expects, axes, period_s, average)
        imu, encoders, temperatures, drives = settings.imu, settings.encoders, settings.temperatures, settings.drives
        longest = max((each.settling_ticks + 1 for each in drives), default=1)
        self._block = _block_for(int(imu is not None), len(encoders), len(temperatures), len(drives), longest)
        memory = self._memory = memory_in(self._block)
        self._imu = None if imu is None else ImuJudge(imu, window, memory.imus)
        drive_judges = [DriveJudge(each, window, memory.drives[k : k + 1], memory.sent[k]) for k, each in enumerate(drives)]
        self._judges: list[Judge] = [
            *([] if self._imu is None else [self._imu]),
            *(EncoderJudge(each, memory.pairs[k : k + 1]) for k, each in enumerate(encoders)),
            *(TemperatureJudge(each, memory.thermometers[k : k + 1]) for k, each in enumerate(temperatures)),
            *drive_judges,
        ]
        self._of_windows: list[DriveJudge | ImuJudge] = [*drive_judges, *([] if self._imu is None else [self._imu])]
        self._law = law
        self.sensors = tuple(judge.sensor for judge in self._judges)
        self._period_s = period_s
        self._noticed = noticed
        self.begin()

    def begin(self) -> None:
        """Begin a session: nothing is known of any sensor."""
        for judge in self._judges:
            judge.begin()
        if self._window is not None:
            self._window.begin()
        self.restart()

    def restart(self) -> None:
        """Begin a recording: findings so far are not its own; what is still wrong is found again."""
        self.marks = 0
        self._is_failing = False
        self._memory.found[:] = 0
        self._failed = [""] * len(self._judges)
        self._findings: dict[tuple[str, str], Finding] = {}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found since the last restart, in the order in which it was."""
        return tuple(self._findings.values())

    def step(self, sample: Sample, ticks: int, time_s: float, *, led: bool = True) -> str:
        """Judge one sample.

        Parameters
        ----------
        sample : Sample
        ticks : int
            Since the sample before: 1, and more after lost ticks.
        time_s : float
            Of its row.
        led : bool
            Whether all axes are homed, their brakes open; otherwise only thermometers are judged, which need no motion.

        Returns
        -------
        str
            Why the motors must be stopped, in words; '' when they need not.
        """
        window, is_over = self._window, False
        if window is not None and led:
            window.step(sample, ticks)
            is_over = window.over
        if is_over:
            for each in self._of_windows:
                each.take_window()
        if self._imu is not None and sample.imu_fault:
            self._imu.take_fault(sample)
        is_failing = self._law(
            self._block,
            sample.memory,
            sample.imu_counter,
            sample.imu_time_s,
            sample.imu_damaged,
            sample.imu_fault != "",
            sample.lateness_s,
            sample.io_age_s,
            ticks,
            is_over,
            led,
        )
        if not is_failing and not self._is_failing:
            return ""
        self._is_failing = is_failing
        return self._take_findings(time_s, led=led)

    def has_to_rehearse(self) -> bool:
        """Return whether `rehearse` has anything to do."""
        return self._window is not None and self._window.is_to_rehearse

    def rehearse(self) -> None:
        """Execute what the end of a motion window takes, shortly before it: it is code that no other tick has brought into the caches."""
        if self._window is not None and self._window.rehearse():
            for each in self._of_windows:
                each.take_window()  # the newest window once more

    def _take_findings(self, time_s: float, *, led: bool) -> str:
        """Keep what was found in the newest sample; return why the motors must be stopped, or ''."""
        marks, reason = 0, ""
        for bit, (judge, found) in enumerate(zip(self._judges, self._memory.found.tolist(), strict=True)):
            if not led and not isinstance(judge, TemperatureJudge):
                continue
            check = judge.checks[found]
            if check != self._failed[bit]:
                self._change(bit, judge, check, time_s)
            if check:
                marks |= 1 << bit
                finding = self._findings.get((judge.sensor, check))
                if finding is not None:
                    finding.last_s = time_s
                    finding.rows += 1
                if judge.follows == "stop" and not reason:
                    reason = f"{judge.sensor}: {judge.says(check)}"
        self.marks = marks
        return reason

    def finish(self, time_s: float) -> None:
        """Judge what the end of a run, at this time, has cut off."""
        for bit, judge in enumerate(self._judges):
            if isinstance(judge, EncoderJudge) and not self._failed[bit] and (check := judge.finish()):
                self._change(bit, judge, check, time_s)

    def _change(self, bit: int, judge: Judge, check: str, time_s: float) -> None:
        """Keep what begins to fail, and tell who listens."""
        before, self._failed[bit] = self._failed[bit], check
        if before and self._noticed is not None:
            self._noticed(time_s, judge.sensor, before, "")
        if not check:
            return
        says = judge.says(check)
        key = (judge.sensor, check)
        if key not in self._findings and len(self._findings) < MOST_FINDINGS:
            since_s = max(0.0, time_s - judge.lag_ticks * self._period_s)
            self._findings[key] = Finding(judge.sensor, check, says, judge.follows, since_s, time_s, time_s)
        if self._noticed is not None:
            self._noticed(time_s, judge.sensor, check, says)
