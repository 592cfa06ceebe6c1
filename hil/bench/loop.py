"""The sample loop: one row per SYNC, feedback and excitation from precomputed plans, limits checked, motors stopped on every error.

A tick does not allocate growing memory, log or print, and waits only for the next tick and the devices' answers. Rows leave through a sink
that only copies.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from controllers.settings import AxisLimits
from drivers.events import Events
from drivers.interface import MachineLink, Sample
from drivers.judging.judge import SensorJudge
from hil.bench.bounds import Bounds
from hil.bench.control import Control
from hil.bench.judging import judged_lines
from hil.bench.row_layout import RowLayout
from hil.bench.signals import Signals, StopRequest
from hil.bench.timing import LoopTiming
from hil.errors import LoopAbortedError

PROGRESS_TICKS = 128
"""Ticks between calls of the progress callback: twice a second at 256 Hz."""
SILENT_S = 0.05
"""Of the loop itself, from which what happened then is told as what came of it: a computer at other work takes less."""


class Sink(Protocol):
    """A destination of rows."""

    @property
    def keeps(self) -> bool:
        """Whether its rows are a recording, of which an error says how much there is."""

    def put(self, row: np.ndarray) -> None:
        """Copy one row; never blocks."""


class TickClock(Protocol):
    """Interface of a clock beyond `drivers.interface.Clock`: when the last tick's work was done, and how many ticks were lost."""

    idle_began_s: float
    tick_began_s: float

    @property
    def missed(self) -> int:
        """Number of ticks skipped."""


class Observer(Protocol):
    """An observer that sees every recorded row and may add to the command (`hil.observing.live.LiveObserver`)."""

    estimate: np.ndarray  # (channels,) overwritten by every step; goes into the row
    effort: np.ndarray  # (n_axes,) overwritten by every step; is added to the command before saturation

    def restart(self, rows: int) -> None:
        """Restart before row 0 of a plan of this many ticks."""

    def step(self, sample: Sample, command: np.ndarray, tick: int) -> None:
        """Take one row: the latched sample, the effort (n_axes,) that the row before has asked for, and the tick of the plan."""


class _EndedError(Exception):
    """The run must end: where, and why; what became of the machine is known only after the stop."""


_UNTIMED = (0.0, math.nan, math.nan)


@dataclass
class SampleLoop:
    """One machine, one control, one row layout.

    Parameters
    ----------
    link : MachineLink
        The machine, real or emulated.
    clock : TickClock
        The clock the link ticks by.
    control : Control
        All axes' feedback.
    limits : sequence of AxisLimits
        Every sample is checked against these, as they are when the loop is made.
    layout : RowLayout
        The column of each value.
    guard_io : bool
        Whether hold-to-run, door and the age of the I/O are watched (False for a machine without I/O).
    io_stale_s : float
        Age of the I/O's state at which the motors are stopped.
    overrun_ticks, stale_ticks : int
        Ticks lost at once, and ticks in a row without a position, that are tolerated; more stop the motors. A tick in which no node answers
        is lost, too: the command stays. How many of those are tolerated is the link's to judge.
    braked : sequence of bool
        Which axes have a brake that the I/O reports; it must be open throughout a run.
    timed : bool
        False in lockstep: work and answer times are those of the host, and are left out of the rows so that runs repeat bit for bit.
    watch : callable, optional
        Returns in words what the link's own watch over its encoders finds wrong with a sample; '' when nothing is wrong.
    observer : Observer, optional
        Steps once per recorded row, between the sample and the feedback; runs without a sink are not watched.
    judge : SensorJudge, optional
        Judges every sample's sensors; its marks go into the row.
    events : Events, optional
        Is told who asked for a stop, and why.
    """

    link: MachineLink
    clock: TickClock
    control: Control
    limits: Sequence[AxisLimits]
    layout: RowLayout
    guard_io: bool
    io_stale_s: float
    overrun_ticks: int
    stale_ticks: int
    braked: Sequence[bool] = ()
    timed: bool = True
    stop_request: StopRequest = field(default_factory=StopRequest)
    watch: Callable[[Sample], str] | None = None
    observer: Observer | None = None
    judge: SensorJudge | None = None
    events: Events | None = None

    def __post_init__(self) -> None:
        """Allocate everything that a tick needs."""
        axes = len(self.limits)
        self._bounds = Bounds(self.limits, self.stale_ticks)
        self._unjudged = 0  # ticks since the sensors were judged
        self._row = np.full(self.layout.width, np.nan)
        self._zeros = np.zeros(axes)
        self._added = np.zeros(axes)  # excitation and what the observer adds

    def run(self, plan: Signals, sink: Sink | None = None, progress: Callable[[int], None] | None = None) -> LoopTiming:
        """Run a plan, a row per tick; rows of lost ticks are skipped.

        Raises
        ------
        LoopAbortedError
            A limit, a stale position, the I/O, an overrun or a stop request ended the run; the motors were stopped first.
        DriverError
            The link lost a device; it has stopped the motors.
        """
        rows = len(plan.reference)
        k = -1  # tick of the plan; lost ticks count
        observer = self.observer if sink is not None else None
        if observer is not None:
            observer.restart(rows)
        lateness, work, answer, write = np.zeros((4, rows))
        missed_before = missed_seen = self.clock.missed
        handed_over_s = 0.0
        done = unanswered = 0
        self._unjudged = 0
        if self.judge is not None:
            self.judge.restart()
        try:
            for signal in (plan.reference, plan.reference_raw, plan.excitation, plan.feedforward):
                if signal is not None and signal.shape[1] != len(self.limits):
                    raise ValueError(f"a plan of {signal.shape[1]} axes for a loop of {len(self.limits)}: one is longer")
                if signal is not None and len(signal) < rows:
                    raise ValueError(f"a plan of {rows} rows with a signal of {len(signal)}")
            while k + 1 < rows:
                sample = self.link.exchange(self.control.effort)
                lost = self.clock.missed - missed_seen
                missed_seen += lost
                k += 1 + (lost if done else 0)  # row 0 is wherever the run begins
                is_whole = sample.is_whole
                unanswered += not is_whole
                overrun = ""
                if lost > self.overrun_ticks:
                    overrun = f"the loop lost {lost} ticks in a row; timing.overrun_ticks bridges {self.overrun_ticks}"
                if k >= rows:  # the plan ended within the lost ticks; the newest sample is checked regardless
                    self.control.expect(sample)
                    found = self._bounds.see(sample, plan.reference[-1])
                    reason = self.stop_request.reason or self._violation(sample, plan.reference[-1], found, 1 + lost, rows)
                    if reason := self._after_silence(sample, lost, reason) or overrun:
                        raise _EndedError(f"after row {done - 1}", reason)
                    break
                tail_s = self.clock.idle_began_s - handed_over_s if done else 0.0
                excitation = plan.excitation[k]
                if observer is not None:
                    observer.step(sample, self.control.demand, k)
                    excitation = np.add(excitation, observer.effort, out=self._added)
                reason = self._step(sample, plan, k, excitation, 1 + lost, is_whole=is_whole)
                reason = (self._after_silence(sample, lost, reason) if reason else "") or overrun
                handed_over_s = time.perf_counter()
                began_s = self.clock.tick_began_s
                timing_s = sample.lateness_s, handed_over_s - began_s + tail_s, sample.arrived_s - began_s
                lateness[done], work[done], answer[done] = timing_s
                write[done] = tail_s
                done += 1
                if sink is not None:
                    timing_s = timing_s if self.timed else _UNTIMED
                    self.layout.fill(
                        self._row, k, sample, plan, self.control.command, timing_s, self.judge.marks if self.judge is not None else 0
                    )
                    if observer is not None:
                        self._row[self.layout.observed] = observer.estimate
                    sink.put(self._row)
                if reason:
                    raise _EndedError(f"row {done - 1}", reason)
                if progress is not None and k % PROGRESS_TICKS == 0:
                    progress(k)
        except _EndedError as ended:
            where, reason = ended.args
            self._say_stop(reason)
            self.link.stop()
            kept = f"{done} rows are kept" if sink is not None and sink.keeps else "nothing was recorded"
            prefix = f"{where}: " if sink is not None and sink.keeps else ""
            error = LoopAbortedError(f"{prefix}{reason}; {self.link.outcome}; {kept}")
            for finding in () if self.judge is None else self.judge.findings:
                if finding.says not in reason:
                    error.add_note(f"from {finding.since_s:.3f} s on, {finding.sensor}: {finding.says}")
            raise error from None
        except BaseException:
            self.link.stop()
            raise
        if self.judge is not None:
            self.judge.finish(max(k, 0) * self.layout.period_s)
        judged = () if self.judge is None else judged_lines(self.judge.findings, done)
        missed = self.clock.missed - missed_before
        return LoopTiming(done, missed, unanswered, lateness[:done], work[:done], answer[:done], write[:done], judged=judged)

    def _after_silence(self, sample: Sample, lost: int, reason: str) -> str:
        """Return why the motors must be stopped, and that this program stood still before, where it has: asleep, or within a tick."""
        if not reason or reason == self.stop_request.reason:
            return reason
        silent_s = max(sample.lateness_s, lost * self.layout.period_s)
        is_long = silent_s > max(self.overrun_ticks * self.layout.period_s, SILENT_S)
        return f"this program stood still for {silent_s:.2f} s; {reason}" if is_long else reason

    def _say_stop(self, reason: str) -> None:
        """Tell the audit trail who asked for a stop, and why."""
        if self.events is not None:
            self.events.add("operator" if reason == self.stop_request.reason else "loop", "stop asked", reason=reason)

    def _step(self, sample: Sample, plan: Signals, k: int, excitation: np.ndarray, ticks: int, *, is_whole: bool) -> str:
        """Compute the next command; return why the motors must be stopped, or ''."""
        reference = plan.reference[k]
        if self.control.led:
            self._follow_drives(sample, plan, k, is_whole=is_whole)
            self.control.expect(sample)  # before the next step changes what was commanded
        found = self._bounds.see(sample, reference)
        if is_whole:
            feedforward = self._zeros if plan.feedforward is None else plan.feedforward[k]
            self.control.step(reference, self._bounds.position, excitation, feedforward)
        return self.stop_request.reason or self._violation(sample, reference, found, ticks, k)

    def _follow_drives(self, sample: Sample, plan: Signals, k: int, *, is_whole: bool) -> None:
        """Let the filters of axes whose drives close loops of their own make up for ticks whose positions did not come."""
        for axis in self.control.led:
            position, before = float(sample.position[axis]), float(self._bounds.position[axis])
            if not is_whole or position != position:
                self.control.fall_behind(axis)
            elif before == before:
                self.control.catch_up(axis, plan.reference[: max(k, 1), axis], before, position)

    def _violation(self, sample: Sample, reference: np.ndarray, found: int, ticks: int, k: int) -> str:
        """Return why the motors must be stopped, or ''; `found` is what is out of the loop's own bounds.

        Sensors are judged when they answer, not when the whole bus is late.
        """
        judged = ""
        self._unjudged += ticks
        if self.judge is not None and not sample.unanswered:
            ticks, self._unjudged = self._unjudged, 0
            judged = self.judge.step(sample, ticks, k * self.layout.period_s)
        if sample.fault:
            return sample.fault
        if found:
            return self._bounds.says(found, reference)
        if self.watch is not None and (reason := self.watch(sample)):
            return reason
        return (self._guarded(sample) if self.guard_io else "") or judged

    def _guarded(self, sample: Sample) -> str:
        """Return what of the I/O stops the motors, or ''."""
        if not sample.io_age_s <= self.io_stale_s:  # the rest of such a state is the safe one, not what was read
            return f"the I/O has given no valid state for {sample.io_age_s:.2f} s, {self.io_stale_s:.2f} s are allowed"
        if not sample.hold_to_run:
            return "hold-to-run was released"
        is_open = sample.brakes_open.tolist()
        if False in is_open:
            for axis, has_brake in enumerate(self.braked):
                if has_brake and not is_open[axis]:
                    return f"{self.limits[axis].axis}: its brake reports closed during the run"
        return "" if sample.door_closed else "the door was opened"
