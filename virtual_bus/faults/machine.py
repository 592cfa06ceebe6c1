"""The emulated machine with seams at which faults act, a schedule of faults, and a log of its true motion.

Without faults an `EmulatedMachine` is built and none of this exists.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from functools import partial

import numpy as np

from virtual_bus.canopen.nmt import NmtState
from virtual_bus.canopen.node import Emit, Handler, Node
from virtual_bus.canopen.power_state import PowerState
from virtual_bus.faults.condition import MOVING_SPEED, SETTLED_S, STILL_SPEED
from virtual_bus.faults.devices import FaultyBrakes, FaultyImu, FaultyIo
from virtual_bus.faults.motion_log import HOLDING, MotionLog
from virtual_bus.faults.schedule import Injection, Schedule
from virtual_bus.faults.seam import Seam
from virtual_bus.machine import EmulatedMachine
from virtual_bus.physics import Physics
from virtual_bus.sensors.sensing import Latched
from virtual_bus.settings import EmulatedBus

Frame = tuple[int, bytes]
HOMING_MODE = 6
_STOPPING = (PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE)

REST_S = 1.0
"""All axes must have been still this long before the machine counts as at rest: half a swing of an arm that hangs free takes as much."""


class FaultyMachine(EmulatedMachine):
    """A whole machine behind its wires, some of it at fault.

    Parameters
    ----------
    physics, bus, period_s, imu, io, witness
        As of `EmulatedMachine`.
    brakes : FaultyBrakes
        The brakes that `io` works; without an `io` the drives work them.
    seed : int
        Of what is random in a fault.

    Attributes
    ----------
    efforts : Seam
        By axis: from the effort that the drive's automaton asks for to that of its power stage [drive's unit].
    sensors : Seam
        By axis: change the readings of an instant (the axis's number is bound).
    reports : Seam
        By node: called when the node's values are latched, before it answers a SYNC.
    heard : Seam
        By node: from a frame on the bus to what the node hears, None: nothing.
    said : Seam
        By node: from a frame that the node sends to those on the bus.
    wire : Seam
        Key "in" (towards the devices) and "out": from a frame to those that pass.
    intruders : Seam
        Key "": called once per SYNC before the devices answer, for a foreign participant.
    produced : Seam
        Key "": whether the machine's own producer sends the SYNC that is due.
    samples : Seam
        Key "": called once per sample.
    recording : bool
        Whether rows are being recorded; the bench sets it, where it is in this process.
    log : MotionLog, optional
        Takes the true motion from power-on; None: nobody wants it, and a machine may run for days.
    """

    def __init__(
        self,
        physics: Physics,
        bus: EmulatedBus,
        period_s: float,
        *,
        brakes: FaultyBrakes,
        imu: FaultyImu | None = None,
        io: FaultyIo | None = None,
        witness: Callable[[float], None] | None = None,
        seed: int = 0,
        log: MotionLog | None = None,
    ) -> None:
        super().__init__(physics, bus, period_s, imu=imu, io=io, witness=witness)
        self.faulty_imu, self.faulty_io, self.brakes = imu, io, brakes
        self.efforts: Seam[Callable[[float], float]] = Seam()
        self.sensors: Seam[Callable[[Latched, int], None]] = Seam()
        self.reports: Seam[Callable[[], None]] = Seam()
        self.heard: Seam[Callable[[int, bytes], Frame | None]] = Seam(self._collect_routes)
        self.said: Seam[Callable[[int, bytes], list[Frame]]] = Seam()
        self.wire: Seam[Callable[[int, bytes], list[Frame]]] = Seam()
        self.intruders: Seam[Callable[[], None]] = Seam()
        self.produced: Seam[Callable[[], bool]] = Seam()
        self.samples: Seam[Callable[[], None]] = Seam()
        self.recording = False
        self.log = log
        self.nodes: dict[str, Node] = {**self.drives, **self.encoders}
        self._schedule = Schedule()
        self._seed = seed
        self._emit: Emit = lambda can_id, data: None
        self._answering = False
        joints = physics.plant.joint_of_axis()
        self._joints = np.array([joints[axis] for axis in physics.axes], dtype=np.intp)
        self._drive_of = {drive.settings.axis: drive for drive in self.drives.values()}
        self._drive_in_order = [self._drive_of.get(axis) for axis in physics.axes]
        self._braked = [physics.settings.tree.joints[joint].brake_effort > 0.0 for joint in self._joints]
        self._link_joints = {
            encoder.channel.removeprefix("link_position_"): [physics.settings.tree.joint_index(name) for name in encoder.joints]
            for encoder in physics.settings.encoders
            if encoder.channel.startswith("link_position_")
        }
        self._temperature = np.full(len(physics.axes), math.nan)
        self._still_samples = [0] * len(physics.axes)  # per axis that is free to move
        self._rest_samples = 0  # of all axes, whatever holds them

    # ---- faults ---------------------------------------------------------------------------------------
    def inject(self, injection: Injection) -> None:
        """Add a fault to the run; before `power_on`."""
        self._schedule.add(injection)

    @property
    def schedule(self) -> Schedule:
        """The faults of this run."""
        return self._schedule

    def random(self, label: str) -> np.random.Generator:
        """Return the random numbers of one fault, its own stream whatever else is random."""
        return np.random.default_rng([self._seed, zlib.crc32(label.encode())])

    def drive_at(self, axis: str) -> Node:
        """Return the drive of an axis."""
        return self._drive_of[axis]

    # ---- what conditions ask ----------------------------------------------------------------------------
    def quantity(self, name: str) -> float:
        """Return one of `quantity_names` in SI: true motion, the drive's effort, what the winding's sensor shows."""
        if name == "time":
            return self.time_s
        axis = max((axis for axis in self.physics.axes if name.endswith(f"_{axis}")), key=len)
        kind = name.removesuffix(f"_{axis}")
        index = self.physics.axes.index(axis)
        if kind == "position":
            return float(self.physics.joint_positions[self._joints[index]])
        if kind == "link_position":
            return float(sum(self.physics.joint_positions[joint] for joint in self._link_joints[axis]))
        if kind == "speed":
            return float(self.physics.joint_speeds[self._joints[index]])
        if kind == "command":
            return float(self._effort[index])
        if kind == "temperature":
            return float(self._temperature[index])
        drive = self._drive_of.get(axis)
        return float(drive.objects.number(0x6041)) if drive is not None else math.nan

    def is_in(self, state: str, axis: str) -> bool:
        """Return whether an axis is in one of `condition.STATES`, any where `axis` is ""."""
        if state == "recording":
            return self.recording
        chosen = [index for index, name in enumerate(self.physics.axes) if axis in ("", name)]
        return any(self._axis_is_in(state, index) for index in chosen)

    def _axis_is_in(self, state: str, index: int) -> bool:
        drive = self._drive_in_order[index]
        enabled = drive is not None and drive.power_state is PowerState.OPERATION_ENABLED
        if state == "moving":
            return abs(float(self.physics.joint_speeds[self._joints[index]])) > MOVING_SPEED
        if state == "settled":
            return enabled and self._still_samples[index] * self.period_s >= SETTLED_S
        if state == "operational":
            return drive is not None and drive.state is NmtState.OPERATIONAL
        if state == "homing":
            return drive is not None and drive.objects.number(0x6061) == HOMING_MODE
        if state == "enabled":
            return enabled
        if state == "stopping":
            return drive is not None and drive.power_state in _STOPPING
        if not self._braked[index]:
            return False
        return self.brakes.is_open[index] is (state == "brakes open")

    # ---- life -----------------------------------------------------------------------------------------
    def connect(self, emit: Emit) -> None:
        """Set where frames go."""
        self._emit, self._put = emit, self.put
        for node in self._nodes:
            node.connect(partial(self._say, node.node_id))

    def power_on(self) -> None:
        """Boot every device; faults that are there from the start come first."""
        self._schedule.step(self, self.time_s)
        super().power_on()

    # ---- frames ---------------------------------------------------------------------------------------
    def _collect_routes(self) -> None:
        sync = self.bus.sync_cob_id
        routes: dict[int, list[Handler]] = {}
        for node in self._nodes:
            filtered = bool(self.heard.at(node.node_id))
            for can_id, handler in node.routes.items():
                if can_id != sync:
                    routes.setdefault(can_id, []).append(partial(self._hear, node.node_id, can_id, handler) if filtered else handler)
        self._routes = routes
        self._take_sync_nodes([node for node in self._nodes if sync in node.routes and self._passes(node.node_id, sync, b"") is not None])

    def _passes(self, node_id: int, can_id: int, data: bytes) -> Frame | None:
        frame: Frame | None = (can_id, data)
        for change in self.heard.at(node_id):
            frame = change(*frame) if frame is not None else None
        return frame

    def _hear(self, node_id: int, can_id: int, handler: Handler, data: bytes) -> None:
        frame = self._passes(node_id, can_id, data)
        if frame is not None:
            handler(frame[1])

    def _say(self, node_id: int, can_id: int, data: bytes) -> None:
        frames: list[Frame] = [(can_id, data)]
        for change in self.said.at(node_id):
            frames = [said for frame in frames for said in change(*frame)]
        for frame in frames:
            self.put(*frame)

    def put(self, can_id: int, data: bytes) -> None:
        """Put a frame on the bus as the master sees it, whoever sent it."""
        frames: list[Frame] = [(can_id, data)]
        for change in self.wire.at("out"):
            frames = [passed for frame in frames for passed in change(*frame)]
        for frame in frames:
            self._emit(*frame)

    def intrude(self, can_id: int, data: bytes) -> None:
        """Put a frame on the bus that no device of this machine sent: devices and master see it."""
        if self.wire.at("in"):
            return  # where the devices are cut off, so is the intruder
        if can_id == self.bus.sync_cob_id:
            self.put(can_id, data)
            self.answer_foreign_sync(data)
            return
        for handler in self._routes.get(can_id, ()):
            handler(data)
        self.put(can_id, data)

    def receive(self, can_id: int, data: bytes) -> None:
        """Take one data frame from the master, where it arrives."""
        frames: list[Frame] = [(can_id, data)]
        for change in self.wire.at("in"):
            frames = [passed for frame in frames for passed in change(*frame)]
        for frame in frames:
            super().receive(*frame)
        if can_id == self.bus.sync_cob_id and not self.bus.produces_sync and can_id not in [frame[0] for frame in frames]:
            self._pass_unheard()

    def produce_sync(self) -> None:
        """Send the SYNC of the machine's own producer, if it still sends any; the period passes regardless."""
        sync = self.bus.sync_cob_id
        if not all(sends() for sends in self.produced.at("")):
            self._pass_unheard()
            return
        self.put(sync, b"")
        frames: list[Frame] = [(sync, b"")]
        for change in self.wire.at("in"):
            frames = [passed for frame in frames for passed in change(*frame)]
        if frames:
            self._sync(b"")
        else:
            self._pass_unheard()

    def _pass_unheard(self) -> None:
        """Let the sample period of a SYNC pass that no device has heard."""
        self._idle.sync()
        self._tick_nodes()
        self._act()
        self._read(self.physics.latch_exactly())
        self._advance()

    # ---- one sample -----------------------------------------------------------------------------------
    def _sync(self, data: bytes) -> None:
        self._answering = True
        for intrude in self.intruders.at(""):
            intrude()
        super()._sync(data)
        self._answering = False

    def _act(self) -> None:
        super()._act()
        if axes := self.efforts.places():
            effort = self._effort
            for axis in axes:
                index = self.physics.axes.index(str(axis))
                for change in self.efforts.at(axis):
                    effort[index] = change(float(effort[index]))
            self.physics.apply(effort)

    def _read(self, latched: Latched) -> None:
        for axis in self.sensors.places():
            index = self.physics.axes.index(str(axis))
            for disturb in self.sensors.at(axis):
                disturb(latched, index)
        self._temperature[:] = latched.temperature_degC
        super()._read(latched)
        for node_id in self.reports.places():
            for report in self.reports.at(node_id):
                report()

    def _advance(self) -> None:
        if self._witness is not None and not self._answering:
            self._witness(self.time_s)  # the truth goes on without SYNCs
        super()._advance()
        for work in self.samples.at(""):
            work()
        speeds: list[float] = self.physics.joint_speeds[self._joints].tolist()
        for index, speed in enumerate(speeds):
            free = not self._braked[index] or self.brakes.is_open[index]
            self._still_samples[index] = self._still_samples[index] + 1 if free and abs(speed) <= STILL_SPEED else 0
        self._rest_samples = self._rest_samples + 1 if all(abs(speed) <= STILL_SPEED for speed in speeds) else 0
        self._schedule.step(self, self.time_s)
        if self.log is not None:
            self._write_log(self.log, speeds)

    def _write_log(self, log: MotionLog, speeds: list[float]) -> None:
        log.add(
            self.time_s,
            self.physics.joint_positions[self._joints].tolist(),
            speeds,
            self._effort.tolist(),
            [share if braked else 0.0 for share, braked in zip(self.brakes.share.tolist(), self._braked, strict=True)],
            [int(drive.power_state) if drive is not None else 0 for drive in self._drive_in_order],
        )

    def _work_brakes(self) -> None:
        self.brakes.settle([drive is not None and drive.power_state in HOLDING for drive in self._drive_in_order])

    def let_rest(self, pass_time: Callable[[float], None], at_most_s: float) -> None:
        """Let the machine's time go on without SYNCs until every axis has been still for `REST_S` since, `at_most_s` [s] at most."""
        began_s, until_s = self.time_s, self.time_s + at_most_s
        while self.time_s < began_s + REST_S or (self.time_s < until_s and self._rest_samples * self.period_s < REST_S):
            pass_time(self.period_s)


def quantity_names(physics_axes: tuple[str, ...], linked: tuple[str, ...]) -> frozenset[str]:
    """Return the quantities of a machine that a condition may name; `linked` are the axes with a link encoder."""
    per_axis = ("position", "speed", "command", "temperature", "statusword")
    return frozenset(
        {"time", *(f"{kind}_{axis}" for kind in per_axis for axis in physics_axes), *(f"link_position_{axis}" for axis in linked)}
    )
