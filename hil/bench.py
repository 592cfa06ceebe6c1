"""The bench: a machine on a bus, commissioned, brought to its start pose, run in closed loop and recorded.

with open_bench(machine, BenchOptions("lockstep:"), start_pose) as bench:
    bench.run(plan, Path("run.mf4"))
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from controllers.feedback import Feedback
from drivers.interface import Sample
from hil.errors import LoopAborted, UnusableInput
from hil.experiments import Move, Plan, Static
from hil.experiments.safety import gravity_feedforward
from hil.layout import AxisColumns, RowLayout
from hil.loop import LoopTiming, SampleLoop, StopRequest
from hil.machine import Machine
from hil.realtime import Scheduling, real_time
from hil.recording import JournalSink, RecorderProcess, recording_metadata
from hil.wiring import Wiring, lockstep_wiring, wall_wiring
from virtual_bus.physics import Physics

T = TypeVar("T")

SETTLE_S = 4.0
"""Standstill before row 0, in which what the way there has set swinging dies out."""

ARRIVED_COUNTS = 20.0
"""Closer than so many encoder counts to a pose no move is made to reach it: two tenths of a milliradian on the C-arm."""


@dataclass(frozen=True)
class BenchOptions:
    """How to reach a machine.

    Parameters
    ----------
    bus_url : str
    imu_device, io_url : str
        Where the IMU and the I/O are, if neither the machine file nor an emulator on this host says so.
    seed : int
        In lockstep, of the emulated sensors' noise.
    noise : bool
        In lockstep, whether they have any.
    frame_log : Path, optional
        Every CAN frame, as candump writes them.
    truth : Path, optional
        In lockstep, what only the emulator knows.
    emulated : Machine, optional
        In lockstep, the machine that is really there, where it differs from its file.
    """

    bus_url: str
    imu_device: str = ""
    io_url: str = ""
    seed: int = 0
    noise: bool = True
    frame_log: Path | None = None
    truth: Path | None = None
    emulated: Machine | None = None


@dataclass
class Bench:
    """A commissioned machine; made by `open_bench`."""

    machine: Machine
    model: Physics  # of the machine file: what holds it where
    options: BenchOptions
    wiring: Wiring
    loop: SampleLoop
    layout: RowLayout
    scheduling: Scheduling
    commissioning: list[str]
    pose: np.ndarray  # (n_axes,) where the machine stands

    def __post_init__(self) -> None:
        self._still = np.zeros(len(self.machine.axes))

    def run(self, plan: Plan, path: Path, progress: Callable[[int], None] | None = None) -> LoopTiming:
        """Take hold, go to the plan's start pose, settle, run it and record every row into `path`, and park again.

        Raises
        ------
        LoopAborted, DriverError
            The motors were stopped; the rows up to then are in `path`.
        """
        way, sink = self._while_ticking(lambda: (self._way_to(plan.start_pose), self._sink(plan, path)))
        ended: dict[str, Any] = {}
        try:
            self._take_hold()
            for leg in way:
                self.loop.run(leg)
            self.pose = plan.start_pose.copy()
            ended["initial"] = self._initial() | {"controller_states": self.loop.feedback.states}
            self.wiring.start_truth()
            timing = self.loop.run(plan, sink, progress)
            self.wiring.pause_truth()
            self.pose = plan.reference[-1].copy()
            self.wiring.link.close_brakes(self._holding())
            ended["timing"] = timing.summary()
            return timing
        except BaseException as error:
            ended["ended"] = {"error": str(error) or type(error).__name__}
            raise
        finally:
            self.wiring.pause_truth()
            self._finish(sink, ended)

    def feedforward(self) -> np.ndarray:
        """What gravity feedforward brings at the present pose (n_axes,), zero where no axis asks for it."""
        brought = gravity_feedforward(self.machine, self.model, self.pose[None, :])
        return np.zeros(len(self.pose)) if brought is None else brought[0]

    def _way_to(self, pose: np.ndarray) -> list[Plan]:
        """From where the machine is parked to standstill at `pose`, within the limits."""
        axes = self.machine.axes
        start = dict(zip(axes, map(float, self.pose), strict=True))
        goal = dict(zip(axes, map(float, pose), strict=True))
        tolerance = np.array([ARRIVED_COUNTS * scaling.position_resolution for scaling in self.wiring.link.scalings])
        legs = Move(start, goal).plans(self.machine) if (np.abs(pose - self.pose) > tolerance).any() else []
        return legs + Static(SETTLE_S, goal).plans(self.machine)

    def _take_hold(self) -> None:
        """Enable the drives, let the feedback hold where the machine stands, open the brakes."""
        link = self.wiring.link
        link.enable()
        self.pose = _measured_pose(link.exchange(self._still))
        effort = self.model.holding_effort(self.pose)
        self.loop.feedback.preload(effort, self.pose, self.feedforward())
        self.loop.command[:] = effort
        link.release_brakes(self._holding())

    def _holding(self) -> Callable[[Sample], np.ndarray]:
        """From a sample to the command that holds the present pose, for phases in which the link ticks by itself."""
        loop, pose, feedforward = self.loop, self.pose.copy(), self.feedforward()
        position = pose.copy()

        def hold(sample: Sample) -> np.ndarray:
            known = np.isfinite(sample.position)
            position[known] = sample.position[known]
            loop.feedback.step(pose, position, self._still, feedforward, loop.command)
            return loop.command

        return hold

    def _while_ticking(self, work: Callable[[], T]) -> T:
        """Do some work while the machine is parked: ticks and heartbeats go on, jitter does no harm. Lockstep time stands still."""
        if self.wiring.lockstep:
            return work()
        with ThreadPoolExecutor(1) as worker:
            result = worker.submit(work)
            while not result.done():
                self.wiring.link.exchange(self._still)
            return result.result()

    def _sink(self, plan: Plan, path: Path) -> JournalSink | RecorderProcess:
        """Where the plan's rows go, ready to take them."""
        bench = {"bus": self.options.bus_url, "scheduler": str(self.scheduling), "commissioning": self.commissioning}
        metadata = recording_metadata(self.machine, plan.metadata, self._initial(), bench=bench)
        return (JournalSink if self.wiring.lockstep else RecorderProcess)(path, self.layout.channels, metadata)

    def _finish(self, sink: JournalSink | RecorderProcess, tables: dict[str, Any]) -> None:
        """Turn the rows into the recording; after a good run the machine is parked meanwhile, after a bad one it has been stopped."""
        if "ended" in tables:
            sink.close(tables)
        else:
            self._while_ticking(lambda: sink.close(tables))

    def _initial(self) -> dict[str, Any]:
        link = self.wiring.link
        brakes = {axis: "open" if link.has_brake(index) else "none" for index, axis in enumerate(self.machine.axes)}
        return {"brakes": brakes, "seed": self.options.seed}


@contextlib.contextmanager
def open_bench(machine: Machine, options: BenchOptions, start_pose: np.ndarray | None = None) -> Iterator[Bench]:
    """A commissioned machine, parked: drives disabled, brakes closed. It is stopped on the way out, whatever happens.

    Parameters
    ----------
    machine : Machine
    options : BenchOptions
    start_pose : (n_axes,) array, optional
        In lockstep, where the emulated machine stands when it is switched on.

    Raises
    ------
    UnusableInput
        The machine file has no bus or no controller.
    DriverError
        A device is absent, wrong, at fault, or a check before motion failed.
    """
    if machine.bus is None:
        raise UnusableInput(f"{machine.name}: its file has no [bus], so it can be simulated, compared and diagnosed, not run")
    if not machine.controllers:
        raise UnusableInput(f"{machine.name}: its file has no [controller], so its loop cannot be closed")
    model = Physics(machine.plant, noise=False)
    feedback = _warm(Feedback(machine.controllers))
    still = np.zeros(len(machine.axes))
    lockstep = options.bus_url.startswith("lockstep:")
    stop_request = StopRequest()
    with contextlib.ExitStack() as stack:
        stack.enter_context(_stopping_on_signals(stop_request))
        wiring = stack.enter_context(lockstep_wiring(machine, options, start_pose) if lockstep else wall_wiring(machine, options))
        scheduling = stack.enter_context(real_time(wanted=not lockstep))
        if lockstep:
            scheduling = Scheduling("lockstep, virtual time", False)
        link = wiring.link
        stack.callback(link.close)
        link.start()
        commissioning = list(link.home(model.holding_effort(_measured_pose(link.exchange(still)))))
        guarded = machine.bus.io is not None
        stale_s = machine.bus.io.stale_after_s if machine.bus.io is not None else np.inf
        layout = row_layout(machine)
        loop = SampleLoop(link, wiring.clock, feedback, machine.limits, layout, guarded, stale_s, stop_request)
        yield Bench(machine, model, options, wiring, loop, layout, scheduling, commissioning, _measured_pose(link.exchange(still)))


def _warm(feedback: Feedback) -> Feedback:
    """The feedback compiled: the first step of a machine must not wait for that."""
    nothing = np.zeros(len(feedback.controllers))
    feedback.step(nothing, nothing, nothing, nothing, nothing.copy())
    feedback.reset()
    return feedback


def row_layout(machine: Machine) -> RowLayout:
    """Columns of this machine's recordings."""
    plant = machine.plant
    return RowLayout(
        [AxisColumns(units.axis, units.position, units.effort) for units in machine.units],
        1.0 / machine.sample_rate_Hz,
        imu=bool(plant.imus) and machine.bus is not None and machine.bus.imu is not None,
        link=any(encoder.channel.startswith("link_") for encoder in plant.encoders),
        temperature=machine.bus is not None and machine.bus.io is not None and bool(machine.bus.io.temperature_registers),
    )


def recording_paths(out: Path, plans: Sequence[Plan]) -> list[Path]:
    """One path per plan: `out` itself for one, `<stem>_r1_e2<suffix>` by realisation and experiment for more (counted from 1)."""
    if len(plans) == 1:
        return [out]
    return [
        out.with_name(f"{out.stem}_r{plan.metadata['realisation'] + 1}_e{plan.metadata['experiment'] + 1}{out.suffix}") for plan in plans
    ]


def _measured_pose(sample: Sample) -> np.ndarray:
    """Where the machine stands: its motor side; the link encoder before homing has given that a meaning."""
    return np.where(np.isfinite(sample.link_position), sample.link_position, np.nan_to_num(sample.position))


@contextlib.contextmanager
def _stopping_on_signals(request: StopRequest) -> Iterator[None]:
    """SIGINT and SIGTERM end the run at the next tick, motors stopped; a second one is as rude as ever."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ask(number: int, frame: FrameType | None) -> None:
        if request.reason:
            raise LoopAborted("interrupted twice; the motors were stopped")
        request.ask(f"asked to stop by {signal.Signals(number).name}")

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
