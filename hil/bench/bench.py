"""The bench: a machine on a bus, commissioned, brought to its start pose, run in closed loop and recorded.

with open_bench(machine, BenchOptions("lockstep:"), start_pose) as bench:
    bench.run(plan, Path("run.mf4"))
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from drivers.errors import DriverError, MotionRefusedError
from drivers.interface import Sample
from hil.bench.audit_trail import events_table, write_events
from hil.bench.holding import Loads
from hil.bench.judging import judged_table
from hil.bench.loop import SampleLoop
from hil.bench.options import BenchOptions
from hil.bench.settling import SETTLE_AT_MOST_S, settle
from hil.bench.start_pose import standing
from hil.bench.timing import LoopTiming
from hil.bench.told_state import HOMING, LETTING_GO, ON_THE_WAY, RECORDING, SETTLING, TAKING_HOLD
from hil.bench.wiring import Wiring
from hil.errors import RecordingError, UnusableInputError
from hil.experiments import Move, Plan, Static
from hil.experiments.safety import gravity_feedforward
from hil.machine import Machine
from hil.processes.real_time import Scheduling, real_time
from hil.recording import JournalSink, RecorderProcess, recording_metadata
from virtual_bus.physics import Physics

if TYPE_CHECKING:
    from hil.observing.live import LiveObserver

ARRIVED_COUNTS = 20.0
"""Encoder counts from a pose within which no move is made to reach it: two tenths of a milliradian on the C-arm."""

BRIDGE_S = 1.0
BRIDGED_SHARE = 0.05
"""Share of the tracking error that stops the motors, by which an axis may coast beyond the travel of its first-move check."""

Tell = Callable[[str, str, int], None]
"""Takes what the bench begins to do, the part of it that is due in words, and how many ticks it takes at most; 0 where nobody knows."""

Beside = contextlib.AbstractContextManager[None]


class Rows(Protocol):
    """An object that is told which SYNCs a recording's rows are, as counts since the nodes were started."""

    def begin(self, syncs: int) -> None:
        """Take note that row 0 follows after this many SYNCs."""

    def end(self, syncs: int) -> None:
        """Take note that the last row was the last of this many SYNCs."""


@dataclass
class Bench:
    """A machine at rest: drives disabled, brakes closed, nodes reset and silent; made by `open_bench`.

    Every recording is a separate session: boot, configuration, homing, hold, way, plan, brakes. Work that takes time (planning, starting a
    recorder, writing a file) is done between sessions, when no node waits for a heartbeat.
    """

    machine: Machine
    options: BenchOptions
    wiring: Wiring
    loop: SampleLoop
    model: Physics  # of the machine file, for holding efforts
    scheduling: Scheduling
    pose: np.ndarray  # (n_axes,) where the machine stands
    commissioning: tuple[str, ...] = ()
    judged: tuple[str, ...] = ()  # what was found of the sensors on the last way that was not recorded, a line each
    observer: LiveObserver | None = None
    tell: Tell = lambda doing, part, ticks: None

    def __post_init__(self) -> None:
        """Prepare the command of zero effort."""
        self._still = np.zeros(len(self.machine.axes))
        self.wiring.link.judged = self.judges
        self._led = False  # whether drives go by themselves
        self._loads = Loads(self.machine, self.model)
        self._beside = self._still  # (n_axes,) effort beside the model's that held the axes where they stand
        self.way_to = self.pose  # (n_axes,) where the present way leads, or the last one led
        self._unjudged = self._missed = 0  # ticks since the sensors were judged, and the clock's lost ones by then

    @property
    def emulated(self) -> bool:
        """Whether an emulator of this host is the machine."""
        return self.wiring.emulated

    def commission(self) -> tuple[str, ...]:
        """Boot, then check the first move, home and check encoder agreement of every axis; return the findings, a line each.

        Raises
        ------
        DriverError
            A device is absent, wrong or at fault, or a check failed; the motors were stopped.
        """
        with self.session():
            self.see_pose()
            self._tell_of_sensors()
            return self.commissioning

    def move(self, pose: np.ndarray) -> np.ndarray:
        """Go to a pose and close the brakes there; nothing is recorded.

        Drives in profile position mode go by themselves, at the axes' limits of speed and acceleration; others are led along a planned way.

        Parameters
        ----------
        pose : (n_axes,) array
            [rad or m]

        Returns
        -------
        (n_axes,) array
            Where the axes stand then [rad or m].

        Raises
        ------
        MotionRefusedError
            Some drives are in profile position mode and others are not.
        LoopAbortedError, DriverError
        """
        link = self.wiring.link
        by_itself = self.by_themselves()
        if by_itself and len(by_itself) < len(link.scalings):
            raise MotionRefusedError(f"{', '.join(by_itself)}: in profile position mode beside axes that are not; use one way for all")
        way, stay = self._way_to(pose)  # refuses a pose that is out of range
        if by_itself:
            with self.session():
                link.enable()
                link.release_brakes(lambda sample: self._still)
                self._led = True
                link.go_to(pose.tolist(), lambda sample: self._still)
                self._led = False
                self._tell_of_sensors()
                link.close_brakes(lambda sample: self._still)
                self.see_pose()
            return self.pose
        with self.session():
            self.take_hold()
            link.watch.lead()
            for leg in self._legs(way, stay):
                self.loop.run(leg)
                self._tell_of_sensors()
            self.tell(SETTLING, "", SETTLE_AT_MOST_S * stay.rows)
            settle(self.loop, link, self.machine.limits, stay)
            self.pose = pose.copy()
            self._let_go()
        return self.pose

    def _tell_of_sensors(self) -> None:
        """Add to `judged` what the phase that has ended, of which no row is recorded, has found of the sensors."""
        findings = () if self.loop.judge is None else self.loop.judge.findings
        lines = (f"{finding.sensor}: {finding.says}" for finding in findings)
        self.judged = tuple(dict.fromkeys((*self.judged, *lines)))

    def judges(self, sample: Sample) -> str:
        """Judge the sensors in a tick that the link makes by itself; return why they stop the motors, or ''."""
        judge, link, missed = self.loop.judge, self.wiring.link, self.wiring.clock.missed
        self._unjudged, self._missed = self._unjudged + 1 + max(0, missed - self._missed), missed
        if judge is None or sample.unanswered:
            return ""
        ticks, self._unjudged = self._unjudged, 0
        return judge.step(sample, ticks, link.syncs * link.period_s, led=self._led)

    def by_themselves(self) -> list[str]:
        """Return the axes whose drives go to poses by themselves."""
        return [scaling.axis for scaling in self.wiring.link.scalings if scaling.mode == "profile_position"]

    def _check_modes(self, plan: Plan) -> None:
        """Refuse a plan that the drives cannot be led along."""
        if by_itself := self.by_themselves():
            raise MotionRefusedError(
                f"{', '.join(by_itself)}: in profile position mode a drive goes to poses by itself: `isocenter move`; a run needs another"
            )
        for axis, name in enumerate(self.machine.axes):
            damps = self.observer is not None and self.observer.damping is not None
            added = damps or plan.excitation[:, axis].any() or (plan.feedforward is not None and plan.feedforward[:, axis].any())
            if added and not self.wiring.link.takes_effort(axis):
                raise MotionRefusedError(f"{name}: its drive takes no effort, so nothing can be excited; map torque_offset in an RPDO")

    def run(
        self,
        plan: Plan,
        path: Path,
        progress: Callable[[int], None] | None = None,
        beside: Callable[[RecorderProcess], Beside] | None = None,
        rows: Rows | None = None,
    ) -> LoopTiming:
        """Go to the plan's start pose, settle, run it and record every row into `path`; its events stand beside it.

        Parameters
        ----------
        plan : Plan
        path : Path
        progress : callable, optional
            Called from time to time with the row, in the loop's own process.
        beside : callable, optional
            On the wall clock, work in another process from before the session to its end; it is given the recorder.
        rows : Rows, optional
            Told when the plan begins and when it has ended.

        Raises
        ------
        LoopAbortedError, DriverError
            The motors were stopped; the rows recorded before are in `path`.

        Notes
        -----
        The way is planned from the machine's position before the session. The first-move check pushes each axis a little, and a smooth
        bridge of one second leads from there to the way. So nothing is planned while the machine waits, and frames repeat on every bus.
        """
        self._check_modes(plan)
        if rows is not None and (producer := self.wiring.link.settings.sync_producer):
            raise UnusableInputError(f"images find their rows by the number of SYNCs, which {producer} sends; expose without sync_producer")
        way, stay = self._way_to(plan.start_pose)
        sink = self._sink(plan, path)
        tables: dict[str, Any] = {}
        events = self.wiring.link.events
        watched = contextlib.nullcontext() if beside is None or isinstance(sink, JournalSink) else beside(sink)
        try:
            with watched, self.session():
                self.take_hold()
                self.wiring.link.watch.lead()
                for leg in self._legs(way, stay):
                    self.loop.run(leg)
                self.tell(SETTLING, "", SETTLE_AT_MOST_S * stay.rows)
                residual, notes = settle(self.loop, self.wiring.link, self.machine.limits, stay)
                tables["initial"] = self._initial() | {"controller_states": self.loop.control.law.states, "standing": residual}
                self.wiring.start_truth()
                if rows is not None:
                    rows.begin(self.wiring.link.syncs)
                events.add("bench", "run begins", rows=plan.rows)
                self.tell(RECORDING, path.name, plan.rows)
                timing = self.loop.run(plan, sink, progress)
                events.add("bench", "run ends", rows=timing.ticks)
                if rows is not None:
                    rows.end(self.wiring.link.syncs)
                self.wiring.pause_truth()
                self.pose = plan.reference[-1].copy()
                self._let_go()
                events.add("bench", "brakes closed, drives disabled")
            if not self.wiring.lockstep:
                tables["timing"] = timing.summary()
            tables["bench"] = self._circumstances()
            tables |= self._found()
        except BaseException as error:
            self.wiring.pause_truth()
            link = self.wiring.link
            tables["ended"] = {"error": str(error) or type(error).__name__, "outcome": link.outcome, "stopping": link.troubles}
            tables |= self._found()
            try:
                sink.close(tables)
                write_events(events, path)
            except RecordingError as problem:
                error.add_note(str(problem))
            raise
        sink.close(tables)
        write_events(events, path)
        return dataclasses.replace(timing, notes=notes + timing.notes + self.wiring.link.remarks)

    @contextlib.contextmanager
    def session(self, *, homes: bool = True) -> Iterator[None]:
        """Start the nodes, and home unless told otherwise, brakes closed; stop and reset them on the way out in any case."""
        link, events = self.wiring.link, self.wiring.link.events
        events.begin()
        self.judged, self._led = (), False
        if self.loop.judge is not None:
            self.loop.judge.begin()
        with contextlib.ExitStack() as stack:
            if self.wiring.lockstep:
                self.scheduling = Scheduling("lockstep, virtual time", False)
            else:
                self.scheduling = stack.enter_context(real_time(wanted=self.options.real_time))
            stack.callback(lambda: events.add("bench", "session ended"))
            stack.callback(link.close)
            try:
                began = {} if self.wiring.lockstep else {"utc": datetime.now(UTC).isoformat(timespec="milliseconds")}
                events.add("bench", "session started", bus=self.options.bus_url, **began)
                if self.options.accepted_margins:
                    events.add("operator", "margins accepted", failing="; ".join(self.options.accepted_margins))
                link.start()
                if homes:
                    self.home()
                yield
            except Exception as error:
                events.add(
                    "drivers" if isinstance(error, DriverError) else "bench", "session failed", error=str(error), outcome=link.outcome
                )
                for trouble in link.troubles:
                    events.add("drivers", "trouble in stopping", trouble=trouble)
                if link.rests and link.outcome not in str(error):
                    error.add_note(link.outcome)
                if link.standstill:
                    error.add_note(link.standstill)
                if link.troubles:
                    more = f" and {len(link.troubles) - 1} more" if len(link.troubles) > 1 else ""
                    error.add_note(f"stopping the motors ran into {link.troubles[0]}{more}")
                raise

    def home(self) -> None:
        """In a session: check the first move, home, and check encoder agreement of every axis."""
        link, axes = self.wiring.link, self.machine.axes
        pose, windup = standing(self.machine, self.model, link.exchange(self._still))
        between = self._loads.between(pose)
        beside = np.clip(self._beside, *between.T)
        found = link.home(
            self.model.holding_effort(pose) + beside,
            windup,
            between - beside[:, None],
            check_first_move=not self.commissioning,
            begins=lambda axis: self.tell(HOMING, f"{axes[axis]}, {axis + 1} of {len(axes)}", 0),
        )
        self._beside = beside + link.found_load
        self.commissioning = self.commissioning or tuple(found)
        for line in found:
            link.events.add("bench", "commissioned", finding=line)

    def take_hold(self) -> None:
        """Let the feedback hold the machine in place, enable the drives, open the brakes.

        A drive that works its own brake opens it when it is enabled: from then on only the command holds the axis.
        """
        link = self.wiring.link
        self.tell(TAKING_HOLD, "", 0)
        self.see_pose()
        effort = self.model.holding_effort(self.pose) + np.clip(self._beside, *self._loads.between(self.pose).T)
        self.loop.control.preload(effort, self.pose, self._feedforward())
        link.enable(self.holding())
        link.events.add("bench", "drives enabled")
        link.release_brakes(self.holding())
        link.events.add("bench", "brakes open")

    def _let_go(self) -> None:
        """Close the brakes of a machine that is held, and keep what its load differs from the model's by."""
        self.tell(LETTING_GO, "", 0)
        self.wiring.link.close_brakes(self.holding())
        self.see_pose()
        beside = self.loop.control.effort - self.model.holding_effort(self.pose)
        beside[self.loop.control.led] = self._beside[self.loop.control.led]  # their drives hold them, by loops of their own
        self._beside = beside

    def see_pose(self) -> None:
        """Read the position of the homed machine."""
        measured = self.wiring.link.exchange(self._still).position
        self.pose = np.where(np.isfinite(measured), measured, self.pose)

    def _legs(self, way: list[Plan], stay: Plan) -> list[Plan]:
        """Return the plans that lead from the present position along a way, and tell how long they take."""
        legs = [self._bridge_to(way[0] if way else stay), *way]
        self.way_to = stay.reference[0]
        self.tell(ON_THE_WAY, "", sum(leg.rows for leg in legs))
        return legs

    def _bridge_to(self, first: Plan) -> Plan:
        """Return a plan of one second from the present position to the start of the way: half a cosine, slow enough for any axis.

        Raises
        ------
        MotionRefusedError
            The machine has moved further than commissioning moves it.
        """
        for axis, limit in enumerate(self.machine.limits):
            stands, begins = self.pose[axis], first.reference[0, axis]
            allowed = BRIDGED_SHARE * limit.tracking_error + self.wiring.link.settings.homings[axis].direction_check_travel
            if not abs(stands - begins) <= allowed:
                raise MotionRefusedError(
                    f"{limit.axis}: stands at {stands:+.5f} {limit.unit}, its way was planned from {begins:+.5f}: it moved by "
                    f"{abs(stands - begins):.1e} since, {allowed:.1e} is allowed; run again to plan from here"
                )
        rows = round(BRIDGE_S * self.machine.sample_rate_Hz)
        ease = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, rows + 1) / rows)[:, None]
        reference = self.pose + ease * (first.reference[0] - self.pose)
        feedforward = None if first.feedforward is None else np.tile(first.feedforward[0], (rows, 1))
        return Plan(first.axes, reference, reference, np.zeros_like(reference), feedforward, self.pose.copy(), first.metadata)

    def holding(self) -> Callable[[Sample], np.ndarray]:
        """Return the function from a sample to the command that holds the present pose, for phases in which the link ticks by itself."""
        control, pose, position, feedforward = self.loop.control, self.pose.copy(), self.pose.copy(), self._feedforward()

        def hold(sample: Sample) -> np.ndarray:
            known = np.isfinite(sample.position)
            position[known] = sample.position[known]
            control.step(pose, position, self._still, feedforward)
            return control.effort

        return hold

    def _feedforward(self) -> np.ndarray:
        """Return the gravity feedforward at the present pose (n_axes,), zero where no axis has one."""
        brought = gravity_feedforward(self.machine, self.model, self.pose[None, :])
        return np.zeros(len(self.pose)) if brought is None else brought[0]

    def _way_to(self, pose: np.ndarray) -> tuple[list[Plan], Plan]:
        """Return plans from the present position to `pose`, within the limits, and a plan of one second of standstill there."""
        axes = self.machine.axes
        start = dict(zip(axes, map(float, self.pose), strict=True))
        goal = dict(zip(axes, map(float, pose), strict=True))
        tolerance = np.array([ARRIVED_COUNTS * scaling.position_resolution for scaling in self.wiring.link.scalings])
        legs = Move(start, goal).plans(self.machine) if (np.abs(pose - self.pose) > tolerance).any() else []
        (stay,) = Static(1.0, goal).plans(self.machine)
        return legs, stay

    def _sink(self, plan: Plan, path: Path) -> JournalSink | RecorderProcess:
        """Return the sink of the plan's rows, ready to take them."""
        observer = None if self.observer is None else self.observer.metadata
        judged = None if self.loop.judge is None else judged_table(self.loop.judge.sensors)
        metadata = recording_metadata(
            self.machine,
            plan.metadata,
            self._initial(),
            bench=self._circumstances(),
            commands=self.machine.commanded,
            observer=observer,
            judged=judged,
            emulated=self.emulated or None,
        )
        channels = self.loop.layout.channels
        if self.wiring.lockstep:
            return JournalSink(path, channels, metadata)
        events = self.wiring.link.events
        noted = None if self.machine.needs_recorder else lambda said: events.add("bench", "recorder stands still", says=said)
        return RecorderProcess(path, channels, metadata, on_stall=noted)

    def _initial(self) -> dict[str, Any]:
        link = self.wiring.link
        brakes = {axis: "open" if link.has_brake(index) else "none" for index, axis in enumerate(self.machine.axes)}
        return {"brakes": brakes, "seed": self.options.seed}

    def _found(self) -> dict[str, Any]:
        """Return what was found of the sensors, and the events of the session."""
        judge = self.loop.judge
        found = {} if judge is None else {"judged": judged_table(judge.sensors, judge.findings)}
        return found | {"events": events_table(self.wiring.link.events)}

    def _circumstances(self) -> dict[str, Any]:
        found = {"bus": self.options.bus_url, "scheduler": str(self.scheduling), "commissioning": list(self.commissioning)}
        accepted = self.options.accepted_margins
        return found | ({"accepted_margins": list(accepted)} if accepted else {})
