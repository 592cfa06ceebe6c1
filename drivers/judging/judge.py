"""All sensors of a machine, judged at every sample: marks for the row, findings for the recording, a reason to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.interface import Sample
from drivers.judging.drive import DriveJudge
from drivers.judging.encoders import EncoderJudge
from drivers.judging.imu import ImuJudge
from drivers.judging.motion_window import MotionWindow
from drivers.judging.settings import Follows, JudgingSettings
from drivers.judging.temperature import TemperatureJudge

MOST_FINDINGS = 64
"""Findings kept, a sensor and a check each; there are fewer pairs on a machine of six axes."""


class Judge(Protocol):
    """One sensor's judge."""

    sensor: str
    follows: Follows
    lag_ticks: int

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

    Attributes
    ----------
    sensors : tuple of str
        What is judged, in the order of the bits of `marks`.
    marks : int
        A bit per sensor that is not to be believed at the newest sample.
    """

    def __init__(self, settings: JudgingSettings, period_s: float, noticed: Callable[[float, str, str, str], None] | None = None) -> None:
        axes = len(settings.drives)
        self._window = None if settings.expects is None else MotionWindow(settings.expects, axes, period_s)
        self._judges: list[Judge] = [
            *([ImuJudge(settings.imu, self._window)] if settings.imu is not None else []),
            *(EncoderJudge(each) for each in settings.encoders),
            *(TemperatureJudge(each) for each in settings.temperatures),
            *(DriveJudge(each, self._window) for each in settings.drives),
        ]
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
        marks, reason = 0, ""
        if self._window is not None and led:
            self._window.step(sample, ticks)
        for bit, judge in enumerate(self._judges):
            if not led and not isinstance(judge, TemperatureJudge):
                continue
            check = judge.step(sample, ticks)
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
