"""The emulated machine: physics, drives, link encoders, IMU and brakes on one time of its own.

Time moves by exactly one sample period per SYNC. While no SYNC comes it follows the clock of the caller of `idle` (see idle_time.py), so
heartbeats run, time-outs expire, and the arm falls if nobody holds it. Where a device of its own sends SYNC, the caller's clock times that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from virtual_bus.canopen.clock import Clock
from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.canopen.encoder import Cia406Encoder
from virtual_bus.canopen.imu import CanImu
from virtual_bus.canopen.nmt import NmtCommand
from virtual_bus.canopen.node import MOST_SYNC_BYTES, Emit, Node
from virtual_bus.canopen.power_state import PowerState
from virtual_bus.idle_time import IdleTime
from virtual_bus.modbus.io_device import EmulatedIo
from virtual_bus.serial.xsens_imu import EmulatedImu
from virtual_bus.settings import EmulatedBus

if TYPE_CHECKING:
    from virtual_bus.physics import Physics
    from virtual_bus.sensors.sensing import Latched

NMT = 0x000
SYNC_NOW_S = 1e-9  # a SYNC that is nearer than this is due: sums of floats miss the instant by less
TEMPERATURE_EVERY = 16  # samples between updates of the temperature registers: windings are slow

_BRAKE_OUTPUT_ON = {PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION_ACTIVE}


class EmulatedMachine:
    """A whole machine behind its wires.

    Parameters
    ----------
    physics : Physics
        Plant, effects and sensors.
    bus : EmulatedBus
        The CANopen devices.
    period_s : float
        Sample period, one per SYNC.
    imu, io : optional
        Devices on the serial line and behind Modbus. Build `io` with ``on_brakes=physics.set_brakes``; without an `io`, each drive works
        its own axis's brake.
    witness : callable, optional
        Called with the machine's time [s] at every SYNC, after the answers: for a recording of the truth.

    Attributes
    ----------
    syncs : int
        SYNCs heard since the last NMT start of any node.
    """

    def __init__(
        self,
        physics: Physics,
        bus: EmulatedBus,
        period_s: float,
        *,
        imu: EmulatedImu | None = None,
        io: EmulatedIo | None = None,
        witness: Callable[[float], None] | None = None,
    ) -> None:
        self.physics, self.bus, self.period_s, self.imu, self.io = physics, bus, period_s, imu, io
        self._clock = Clock()
        self.imu_out: Callable[[bytes], None] = lambda data: None  # takes what the IMU sends
        self._witness = witness
        if imu is not None:
            imu.reading_of = physics.read_by_imu

        def nowhere(can_id: int, data: bytes) -> None:
            """Drop a frame sent before `connect`."""

        axis = physics.axes.index
        self.drives = {d.name: Cia402Drive(d, period_s, nowhere) for d in bus.drives}
        self.encoders = {e.name: Cia406Encoder(e, nowhere) for e in bus.encoders}
        self.bus_imus = {imu.name: CanImu(imu, nowhere) for imu in bus.imus}
        self._drives = [(axis(drive.settings.axis), drive) for drive in self.drives.values()]
        self._encoders = [(axis(encoder.settings.axis), encoder) for encoder in self.encoders.values()]
        self._nodes: list[Node] = sorted(
            [*self.drives.values(), *self.encoders.values(), *self.bus_imus.values()], key=lambda node: node.node_id
        )
        self._sync_nodes: list[Node] = []
        self._takers: list[Callable[[], None]] = []  # the first half of a SYNC without a counter, in all of them
        self._senders: list[Callable[[int | None], None]] = []  # the second half of a SYNC
        self._routes: dict[int, list[Callable[[bytes], None]]] = {}
        self._effort = np.zeros(len(physics.axes))
        self._brakes_closed = [True] * len(physics.axes)
        self._samples = 0
        self.syncs = 0
        self._idle = IdleTime(period_s, bus.silence_s, by_the_wall=bus.by_the_wall)
        self.until_sync_s = period_s if bus.produces_sync else math.inf  # until the machine's own producer sends the next
        self._put: Emit = nowhere
        for node in self._nodes:
            node.clock, node.resolution_s = self._clock, period_s
            node.on_routes = self._collect_routes

    @property
    def time_s(self) -> float:
        """Machine time [s]."""
        return self._clock.now_s

    # ---- life -----------------------------------------------------------------------------------------
    def connect(self, emit: Emit) -> None:
        """Set where frames go."""
        self._put = emit
        for node in self._nodes:
            node.connect(emit)

    def place(self, axis_positions: np.ndarray) -> None:
        """Place the machine at these joint positions (n_axes,) [rad or m].

        It stands still in elastic equilibrium, with brakes closed and the drives' counters at zero.
        """
        self.physics.place(axis_positions)
        for index, drive in self._drives:
            drive.place(float(axis_positions[index]))
        self._read(self.physics.latch_exactly())

    def power_on(self) -> None:
        """Boot every device, in the order of node ids."""
        for node in self._nodes:
            node.power_on(self.time_s)
        if self.imu is not None:
            self.imu_out(self.imu.power_on())

    def _collect_routes(self) -> None:
        sync = self.bus.sync_cob_id
        routes: dict[int, list[Callable[[bytes], None]]] = {}
        for node in self._nodes:
            for can_id, handler in node.routes.items():
                if can_id != sync:
                    routes.setdefault(can_id, []).append(handler)
        self._routes = routes
        self._take_sync_nodes([node for node in self._nodes if sync in node.routes])

    def _take_sync_nodes(self, nodes: list[Node]) -> None:
        self._sync_nodes = nodes
        self._takers = [taker for node in nodes for taker in node.takers]
        self._senders = [sender for node in nodes for sender in node.senders]
        self._clock.due_s = -math.inf  # a device may have begun to look at its values every sample

    # ---- frames and time ------------------------------------------------------------------------------
    def receive(self, can_id: int, data: bytes) -> None:
        """Take one data frame from the bus."""
        if can_id == self.bus.sync_cob_id:
            if self.bus.produces_sync:
                self.answer_foreign_sync(data)
            else:
                self._sync(data)
            return
        if self._idle.waiting:
            self._idle.frame()
        if can_id == NMT and data and data[0] == NmtCommand.START:
            self.syncs = 0
        for handler in self._routes.get(can_id, ()):
            handler(data)

    def receive_remote(self, can_id: int) -> None:
        """Take one remote frame from the bus."""
        for node in self._nodes:
            node.receive_remote(can_id, self.time_s)

    def idle(self, seconds: float) -> None:
        """Let time pass, in slices of any length: silence of the bus, or the time to the next SYNC of the machine's own producer."""
        if self.bus.produces_sync:
            self.until_sync_s -= seconds
            if self.until_sync_s <= SYNC_NOW_S:
                self.until_sync_s += self.period_s
                if self.until_sync_s <= 0.0:
                    self.until_sync_s = self.period_s  # after a pause of this process one SYNC, not a burst
                self.produce_sync()
            return
        idle = self._idle
        idle.add(seconds)
        while idle.step():
            if self._tick_nodes():
                idle.spoken()
            self._act()
            latched = self.physics.latch_exactly()  # the noise of a row must not depend on how long the wait before it was
            self._read(latched)
            if self.imu is not None and (said := self.imu.advance(self.time_s, latched.imu[:6])):
                self.imu_out(said)
            self._advance()

    def produce_sync(self) -> None:
        """Send the SYNC of the machine's own producer, and answer it."""
        self._put(self.bus.sync_cob_id, b"")
        self._sync(b"")

    def prepare(self) -> None:
        """Prepare the answer to a SYNC that is near, so that its values, code and data are at hand.

        What the devices will send does not depend on it.
        """
        self.physics.prepare(np.array([drive.foreseen() for _, drive in self._drives]))
        if self.imu is not None:
            self.imu.rehearse()
        for node in self._sync_nodes:
            node.rehearse()

    def _sync(self, data: bytes) -> None:
        """Answer SYNC k and advance the physics to k+1.

        First comes what is due, then targets, sensors, TPDOs in node-id order, and the IMU. Heartbeats go before the TPDOs: a master that
        waits for the last TPDO has then heard everything of this SYNC, and the order of frames on the bus depends on no race.
        """
        if len(data) > MOST_SYNC_BYTES:
            for node in self._sync_nodes:
                node.malformed += 1
            return
        if self._idle.waiting:
            self._idle.sync()
        self.syncs += 1
        if (clock := self._clock).now_s >= clock.due_s:
            self._tick_nodes()
        self._answer(data, self.physics.latch)
        if self._witness is not None:
            self._witness(self.time_s)  # after the answers, which the recording must not delay
        self._advance()

    def answer_foreign_sync(self, data: bytes) -> None:
        """Answer a SYNC that is not that which moves this machine's time: the devices act and answer."""
        self._answer(data, self.physics.latch_exactly)

    def _answer(self, data: bytes, latch: Callable[[], Latched]) -> None:
        counter = None
        if data:
            counter = data[0]
            for node in self._sync_nodes:
                node.begin_sync(data)
        else:
            for take in self._takers:
                take()
        self._act()
        latched = latch()
        self._read(latched)
        for send in self._senders:
            send(counter)
        if (imu := self.imu) is not None:
            sampled = latched.imu[:6] if imu.is_triggered else self.physics.seen_by_imu()  # on its own clock it makes noise by itself
            if said := imu.on_sync(sampled, self._clock.now_s):
                self.imu_out(said)  # the master is busy with the TPDOs by then

    def _tick_nodes(self) -> bool:
        """Send what is due by the present time, node by node, and return whether there was anything."""
        clock = self._clock
        now_s = clock.now_s
        if now_s < clock.due_s:
            return False
        spoken = False
        for node in self._nodes:
            if now_s >= node.deadline_s or node.event_driven:
                node.tick(now_s)
                spoken = True
        clock.due_s = min((-math.inf if node.event_driven else node.deadline_s for node in self._nodes), default=math.inf)
        return spoken

    def _act(self) -> None:
        """Apply the drives' efforts from the present time on."""
        effort = self._effort
        for index, drive in self._drives:
            effort[index] = drive.command()
        if self.io is None:
            self._work_brakes()
        self.physics.apply(effort)

    def _read(self, latched: Latched) -> None:
        """Hand the sensors' readings to the devices."""
        counts, currents, temperatures = latched.position_counts.tolist(), latched.effort.tolist(), latched.temperature_degC.tolist()
        for index, drive in self._drives:
            drive.latch(counts[index], currents[index], temperatures[index])
        if self._encoders:
            link_counts = latched.link_counts.tolist()
            for index, encoder in self._encoders:
                encoder.latch(link_counts[index])
        for imu in self.bus_imus.values():
            imu.latch(latched.imu[6 * imu.settings.number :][:6])
        if self.io is not None and self._samples % TEMPERATURE_EVERY == 0:
            for axis, temperature in zip(self.physics.axes, temperatures, strict=True):
                self.io.set_temperature(axis, temperature)

    def _advance(self) -> None:
        self.physics.advance()
        self._samples += 1
        self._clock.now_s = now_s = self._clock.now_s + self.period_s
        if self.io is not None:
            self.io.advance(now_s)

    def _work_brakes(self) -> None:
        """Without an I/O device, open each axis's brake while its drive's power stage is on."""
        closed = list(self._brakes_closed)
        for index, drive in self._drives:
            closed[index] = drive.power_state not in _BRAKE_OUTPUT_ON
        if closed != self._brakes_closed:
            self._brakes_closed = closed
            self.physics.set_brakes(np.array(closed))
