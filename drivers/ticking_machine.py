"""A machine on a CAN bus: boot and configure its nodes, exchange process data tick by tick, and stop from any state.

This is all that the sample loop needs of a machine that is ready to run. `drivers.machine_link` adds the phases that make it ready.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import can
import canopen
import numpy as np

from drivers.canopen import cia402
from drivers.canopen.axis_rest import POWERED, AxisRest
from drivers.canopen.cia402 import Mode
from drivers.canopen.cia406 import check_alarms
from drivers.canopen.configuration import configure_node
from drivers.canopen.cyclic import CyclicExchange
from drivers.canopen.eds import load_object_dictionary
from drivers.canopen.heartbeat_consumer import HeartbeatConsumer, refuse_second_bench
from drivers.canopen.identity import await_identity
from drivers.canopen.motion_bounds import MotionWatch
from drivers.canopen.network import NMT_PRE_OPERATIONAL, NMT_START, PolledNetwork
from drivers.canopen.own_limits import SET_SO
from drivers.canopen.process_data import drives
from drivers.canopen.resting import Resting
from drivers.canopen.sdo import SdoNode
from drivers.canopen.stopping import Attempts, Attendant, Unattended
from drivers.errors import BusError, BusTimeoutError, DeviceFaultError, DriverError, SecondMasterError
from drivers.interface import Clock, Sample
from drivers.settings import BusSettings, Node

if TYPE_CHECKING:
    from drivers.modbus.io import Io
    from drivers.serial.imu import ImuDriver

RESET_PATIENCE_S = 0.1  # for a node's boot-up when the bench leaves: none is missed if it does not come
IMU_RETRY_S = 5e-5  # a packet at 921600 baud takes twelve times as long
PENDING_FRAMES = 64  # looked through for the EMCY that explains a fault
NO_VOLTAGE = "its power stage has lost its supply (bit 4 of the statusword); check mains, contactor and fuse"
OPERATION_ENABLED_MASK, OPERATION_ENABLED_VALUE = 0x6F, 0x27


class TickingMachine:
    """A machine on a CAN bus, real or emulated: its nodes, its ticks and its stop.

    Parameters
    ----------
    settings : BusSettings
    bus : can.BusABC
        Open bus, which remains the caller's.
    clock : Clock
        Wall time, or virtual time in lockstep.
    imu : ImuDriver, optional
        Driver of the detector's IMU; configured by `start`.
    io : Io, optional
        Driver of brakes, hold-to-run, door and temperatures. Without one the machine has no brakes the bench could command.
    attendant : Attendant, optional
        Looks after axes that only their drives hold; without one they are held without end.

    Raises
    ------
    ConfigurationRefusedError
        The settings' nodes and PDOs do not make a machine the loop can run.
    """

    def __init__(
        self,
        settings: BusSettings,
        bus: can.BusABC,
        clock: Clock,
        imu: ImuDriver | None = None,
        io: Io | None = None,
        attendant: Attendant | None = None,
    ) -> None:
        self.settings = settings
        self.clock = clock
        self.period_s = settings.sync_period_s
        self.network = PolledNetwork(bus, clock)
        self.heartbeats = HeartbeatConsumer(self.network, settings.nodes, self.period_s)
        self._cyclic = CyclicExchange(self.network, settings, self.heartbeats)
        self.scalings = settings.scalings
        self.axes = tuple(scaling.axis for scaling in settings.scalings)
        self.drives = tuple(drives(settings))
        self.inputs = tuple(self._cyclic.inputs)
        self.sample = Sample(len(self.axes))
        self.watch = MotionWatch(settings.motions, settings.scalings, clock, self.period_s)
        self.notes: tuple[str, ...] = ()  # what nodes cannot do, and which faults were reset, since the last start
        self.stop_trouble: list[str] = []  # what went wrong in the last stop
        self.stopping = False  # from the first step of a stop to its last; a signal handler must not interrupt it
        self.attendant: Attendant = attendant or Unattended()
        self.modes: list[Mode | None] = [None] * len(self.axes)  # of the drives, as far as the bench has chosen them
        self._resting = Resting(self, self._tick_at_rest)
        self._imu, self._io = imu, io
        self._before_sync = None if imu is None else imu.before_sync
        self._imu_triggered = settings.imu is not None and settings.imu.triggered_by_sync
        self._nodes: dict[int, SdoNode] = {}
        self._dictionaries: dict[int, canopen.ObjectDictionary] = {}  # of the EDS files, read once
        self._armed = [(0, 0)] * len(self.axes)  # which bits of each statusword must stay as they are: mask and value
        self._ticking = self._ours = False  # ours: nobody else runs this machine; only then may anything be sent, even to stop it
        self._io_lost = ""
        self.open_brakes: set[str] = set()  # of these axes: they have reported open, and were not told to close since
        self.judged: Callable[[Sample], str] = lambda sample: ""  # why sensors stop the motors, in ticks that the machine makes by itself
        self._malformed_before = (0, 0, 0, 0)
        self._late_ticks = self._none_late = [0] * len(self.axes)  # in a row in which each position came too late
        self.zeros = np.zeros(len(self.axes))  # no effort on any axis

    def start(self) -> None:
        """Boot every node, check its identity, configure it, make it operational, and await every TPDO once. Drives stay disabled.

        Raises
        ------
        NodeAbsentError, DuplicateNodeError, WrongIdentityError, ConfigurationRefusedError, DeviceFaultError, BusTimeoutError, BusError
        SecondMasterError
            Another master is on this bus; nothing was sent.
        """
        if self._ticking:
            self.stop()
        with self.stopping_on_error():
            self._ours = False
            self.watch.forget()
            self.network.stop_heartbeat()
            refuse_second_bench(self.network, self.settings.master_node_id, self.settings.master_heartbeat_period_s)
            self._refuse_intruder()
            self._cyclic.check_sync()
            self._ours = True
            if self._imu is not None:
                self._imu.configure(self.clock.wait)
            self.heartbeats.boot(self.settings.nodes)
            kept = [note for note in self.notes if note.endswith(SET_SO)]
            self.notes = (*kept, *self.heartbeats.boot_remarks, *[note for node in self.settings.nodes for note in self._configure(node)])
            self._cyclic.settings_watch.begin(self._nodes.values())
            self._resting.rests, self.modes = (), [None] * len(self.axes)
            holding = [axis for axis in range(len(self.axes)) if self._is_powered(axis)]
            for axis, output in enumerate(self._cyclic.outputs):
                output.controlword = cia402.QUICK_STOP if axis in holding else cia402.DISABLE_VOLTAGE
            for node in self.settings.nodes:
                self.network.command_nmt(NMT_START, node.node_id)
            self._cyclic.syncs = self.sample.unanswered = 0
            self._late_ticks = self._none_late
            self._cyclic.forget_remarks()
            self.network.passed_over.clear()
            self.heartbeats.await_operational(self.settings.nodes)
            if self.settings.master_heartbeat_period_s > 0.0:
                self.network.start_heartbeat(self.settings.master_node_id, self.settings.master_heartbeat_period_s)
            self._malformed_before = self._malformed()
            self._ticking = True
            self.resume_ticks()
            self._await_first_answers()
            if holding:
                self._resting.take_over(holding)

    def exchange(self, command: np.ndarray) -> Sample:
        """Send `command` (n_axes,), wait for the next tick, return what was latched at its SYNC. See `drivers.interface.MachineLink`.

        Raises
        ------
        DeviceFaultError
            An enabled drive left operation enabled, or a node left the NMT state operational.
        HeartbeatLostError, BusTimeoutError
            A node fell silent, or all of them.
        SecondMasterError
            Somebody else sends what only the bench, or one of its devices, may send.
        MotionRefusedError
            The command holds a value that is no number.
        BusError
            The bus failed.
        """
        sample = self.sample
        try:
            if not self._ticking:
                raise BusError("the machine is not started, or was stopped; start it first")
            overdue_s = self._cyclic.run(command.tolist(), sample, self._before_sync)
            self._refuse_intruder()
            now_s = self._poll(sample, overdue_s)
            for axis, (mask, value) in enumerate(self._armed):
                if self.inputs[axis].statusword & mask != value:
                    self._explain_fault(axis)
            if self.heartbeats.left_operational:
                raise DeviceFaultError("; ".join(filter(None, (self.heartbeats.left_operational, sample.fault))))
            self._check_answers(sample)
            self.heartbeats.check_one(now_s, self.clock.missed * self.period_s + getattr(self.clock, "waited_s", 0.0))
        except BaseException:
            self.stop()
            raise
        sample.arrived_s = time.perf_counter()
        return sample

    @property
    def syncs(self) -> int:
        """Ticks since the nodes were started: SYNCs as a device counts them from its NMT start, where the bench sends them."""
        return self._cyclic.syncs

    @property
    def dropped(self) -> str:
        """What has come malformed since the nodes were started, and was dropped, in words; '' when nothing has."""
        counts = [now - before for now, before in zip(self._malformed(), self._malformed_before, strict=True)]
        firsts = (getattr(one, "first_malformed", "") for one in (self.network, None, self._imu, self._io))
        names = ("frames", "datagrams", "messages of the IMU", "answers of the I/O")
        found = [f"{n} {name}" + (f" (first: {why})" if why else "") for n, name, why in zip(counts, names, firsts, strict=True) if n]
        return f"dropped because malformed: {', '.join(found)}" if found else ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What an operator should know of nodes and bus since the last start, a line each: it was borne, bridged or put right."""
        passed_over = ", ".join(f"{count} {kind}" for kind, count in self.network.passed_over.items())
        lines = (
            *self.notes,
            self.dropped,
            f"ignored on the bus: {passed_over}" if passed_over else "",
            *self._cyclic.remarks,
            *self.heartbeats.remarks,
        )
        return tuple(filter(None, lines))

    def _malformed(self) -> tuple[int, int, int, int]:
        imu = 0 if self._imu is None else self._imu.malformed + self._imu.checksum_errors
        return self.network.malformed, getattr(self.network.can_bus, "malformed", 0), imu, getattr(self._io, "malformed", 0)

    def rehearse(self) -> None:
        """Execute the code of a tick shortly before it, to warm the processor's caches; nothing is sent and nothing changes."""
        if self._imu is not None:
            self._imu.rehearse()
        self._cyclic.rehearse()

    def stop(self) -> None:
        """Stop: quick stop, brakes closed and proven, voltage off, nodes pre-operational. Works from any state, any number of times.

        Never raises: `outcome` says how it ended, `stop_trouble` lists what failed; later steps are tried regardless. Where a brake is not
        proven the drive holds, and this does not return before the attendant lets it. A machine that another bench runs, or that was never
        started, is not touched: neither its bus nor its I/O.
        """
        outer, self.stopping = self.stopping, True
        try:
            if self._ours:
                self._bring_to_rest()
        finally:
            self.stopping = outer

    def close(self) -> None:
        """Stop, and reset the communication of every node, which ends its watch over the bench's heartbeat. Never raises."""
        outer, self.stopping = self.stopping, True
        try:
            self.stop()
            self.network.stop_heartbeat()
            attempts = Attempts()
            for node in self.settings.nodes if self._ours else ():
                if node.axis not in self._resting.held:
                    attempts.make(f"resetting {node.name}", self.heartbeats.reset, node, RESET_PATIENCE_S)
            self._ours = False  # another bench may take it after this
            self.stop_trouble += attempts.trouble
            for sdo in self._nodes.values():
                sdo.close()
            self._nodes = {}
        finally:
            self.stopping = outer

    def set_controlword(self, axis: int, controlword: int) -> None:
        """Set the controlword of an axis' drive for the next tick and all later ones."""
        self._cyclic.outputs[axis].controlword = controlword

    def lead_to(self, axis: int, target: float) -> None:
        """Set the position or velocity that a drive's own loops follow from the next tick on [rad or m; rad/s or m/s]."""
        self._cyclic.outputs[axis].lead_to(target)

    def command_node(self, axis: int, command: int) -> None:
        """Send an NMT command to an axis's drive."""
        self.network.command_nmt(command, self.drives[axis].node_id)

    def stand(self, axis: int) -> None:
        """Let a drive's own loops stand: without speed, or, unless it is enabled, at the position where it is."""
        self._cyclic.outputs[axis].stand()

    def takes_effort(self, axis: int) -> bool:
        """Return whether the drive takes an effort: all of it in torque mode, a part of it in others."""
        return self._cyclic.outputs[axis].takes_effort

    def arm(self, axis: int, armed: bool) -> None:
        """Arm or disarm a drive: an armed drive that leaves operation enabled is a fault."""
        supplied = self.inputs[axis].statusword & cia402.VOLTAGE_ENABLED  # some drives never set it
        self._armed[axis] = (OPERATION_ENABLED_MASK | supplied, OPERATION_ENABLED_VALUE | supplied) if armed else (0, 0)

    def command_brakes(self, open_: dict[str, bool]) -> None:
        """Ask for brakes to open or close; axes without a brake are left out."""
        known = {axis: value for axis, value in open_.items() if self.settings.io is not None and axis in self.settings.io.brake_coils}
        self.open_brakes.difference_update(known)
        if self._io is not None and known:
            self._io.command_brakes(known)

    def has_brake(self, axis: int) -> bool:
        """Return whether the I/O commands a brake of this axis and reports its feedback."""
        io = self.settings.io
        return self._io is not None and io is not None and self.axes[axis] in io.brake_coils and self.axes[axis] in io.brake_feedback_inputs

    def io_is_fresh(self) -> bool:
        """Return whether the I/O's newest state is recent enough; a state that is too old reads as brakes closed and switch released."""
        io = self.settings.io
        return io is None or self.sample.io_age_s <= io.stale_after_s

    def refusal(self) -> str:
        """Return in words why hold-to-run, door or I/O forbid motion; '' when they permit it or are not there."""
        sample, io = self.sample, self.settings.io
        if self._io is None or io is None:
            return ""
        if not self.io_is_fresh():
            since = f"for {sample.io_age_s:.2f} s, {io.stale_after_s:.2f} s are allowed" if np.isfinite(sample.io_age_s) else "yet"
            return f"the I/O has given no valid state {since}: nobody knows of hold-to-run, door and brakes; check its line and supply"
        if not sample.hold_to_run:
            return "hold-to-run is not pressed; press and hold it"
        if not sample.door_closed:
            return "the door is open; close it"
        closed = [axis for axis, is_open in zip(self.axes, sample.brakes_open, strict=True) if axis in self.open_brakes and not is_open]
        return f"{', '.join(closed)}: its brake reports closed during the motion" if closed else ""

    def sdo(self, axis: int) -> SdoNode:
        """Return the object dictionary of an axis' drive."""
        return self._nodes[self.drives[axis].node_id]

    def resume_ticks(self) -> None:
        """Start the ticks again, e.g. after SDO traffic took longer than a period."""
        self._cyclic.start_ticks()

    def _configure(self, node: Node) -> tuple[str, ...]:
        if node.node_id in self._nodes:
            self._nodes[node.node_id].close()
        if node.node_id not in self._dictionaries:
            self._dictionaries[node.node_id] = load_object_dictionary(node.eds, node.node_id)
        sdo = self._nodes[node.node_id] = SdoNode(self.network, node.node_id, node.name, self._dictionaries[node.node_id])
        unnamed = await_identity(sdo, node, self.clock.now, self.heartbeats.has_booted)
        scaling = self.scalings[self.axes.index(node.axis)] if node.role == "drive" else None
        notes = configure_node(sdo, node, self.settings, scaling)
        if node.role == "encoder":
            check_alarms(sdo)
        return unnamed + notes

    def _is_powered(self, axis: int) -> bool:
        """Return whether a drive has voltage although no bench runs it: it may be all that holds its axis."""
        return cia402.decode_state(self.sdo(axis).read_integer(cia402.STATUSWORD)) in POWERED

    def _await_first_answers(self) -> None:
        """Make ticks until every TPDO has come; a node may take as long as to boot, for its host may be late."""
        ticks = math.ceil(max(node.boot_timeout_s for node in self.settings.nodes) / self.period_s)
        for _ in range(ticks):
            self.exchange(self.zeros)
            if not (who := ", ".join(self._cyclic.missing)):
                return
        raise BusTimeoutError(f"{who}: no answer to {ticks} SYNCs within {self.settings.answer_timeout_s} s each")

    def _check_answers(self, sample: Sample) -> None:
        """Where no node answers, or one too late, a bus or host is late: such ticks are lost, for as long as a node may be silent."""
        if not self._cyclic.outstanding:
            self._late_ticks = self._none_late
            return
        is_late, bridged = sample.position_late.tolist(), self._cyclic.silent_ticks
        self._late_ticks = late_ticks = [ticks + 1 if late else 0 for ticks, late in zip(self._late_ticks, is_late, strict=True)]
        late = ", ".join(axis for axis, ticks in zip(self.axes, late_ticks, strict=True) if ticks)
        bus = self.network.can_bus.channel_info
        for ticks, what in ((max(late_ticks), f"{late}: position too late"), (sample.unanswered, f"{bus}: no node has answered")):
            if ticks > bridged:
                allowed = f"{bridged * self.period_s:.3f} s allowed, as for a heartbeat"
                raise BusTimeoutError(f"{what} for {ticks * self.period_s:.3f} s, {allowed}")

    def _refuse_intruder(self) -> None:
        if self.network.intruder:
            raise SecondMasterError(self.network.intruder)

    def _poll(self, sample: Sample, overdue_s: float) -> float:
        """Take what IMU and I/O have sent, and return the clock's time."""
        if self._imu is not None:
            arrived = self._imu.poll(sample)
            awake_s = self.clock.awake_s
            asleep_s = overdue_s - self.settings.answer_timeout_s + awake_s
            while not arrived and self._imu_triggered and (now_s := self.clock.now()) < overdue_s:
                if awake_s <= 0.0 or now_s >= asleep_s:  # rounding may put asleep_s after now_s, and virtual time passes only by waiting
                    self.clock.wait(IMU_RETRY_S)
                arrived = self._imu.poll(sample)
        now_s = self.clock.now()
        if self._io is not None:
            self._io.poll_due(now_s)
            self._io.update(sample)
        return now_s

    def _explain_fault(self, axis: int) -> None:
        """Raise the fault that made a drive leave operation enabled, with the EMCY that may still be in the queue, or lost its supply."""
        node, statusword = self.drives[axis], self.inputs[axis].statusword
        if statusword & OPERATION_ENABLED_MASK == OPERATION_ENABLED_VALUE:
            raise DeviceFaultError(f"{node.name} (node {node.node_id}): {NO_VOLTAGE}")
        for _ in range(PENDING_FRAMES):
            if not self.network.pump(0.0):
                break
        emergency = self.heartbeats.last_emergency(node.node_id) or "no EMCY"
        why = f"left operation enabled: {cia402.describe_statusword(self.inputs[axis].statusword)}"
        words = self.heartbeats.own_silence, f"{node.name} (node {node.node_id}): {why}", emergency
        raise DeviceFaultError("; ".join(filter(None, words)))

    @contextlib.contextmanager
    def stopping_on_error(self) -> Iterator[None]:
        """Tell the motors to stop before an error leaves the block."""
        try:
            yield
        except BaseException:
            self.stop()
            raise

    def _bring_to_rest(self) -> None:
        self.heartbeats.stand_down()
        self._armed = [(0, 0)] * len(self.axes)
        self._io_lost = ""
        attempts = Attempts()
        if self._ticking:
            self._resting.stop_all(attempts, self.attendant)
            attempts.make("reading settings back", self._cyclic.settings_watch.verify)
        else:
            attempts.make("closing the brakes", self.command_brakes, dict.fromkeys(self.axes, False))
        self._ticking = False
        for node in self.settings.nodes:
            if node.axis not in self._resting.held:
                attempts.make(f"{node.name} to pre-operational", self.network.command_nmt, NMT_PRE_OPERATIONAL, node.node_id)
        self.stop_trouble = attempts.trouble + ([f"I/O: {self._io_lost}"] if self._io_lost else [])

    def rest_axes(self, axes: Sequence[int], effort: np.ndarray | None) -> None:
        """Prove the closed brakes of standing axes and take their voltage; see `drivers.canopen.resting.Resting.rest_axes`."""
        self._resting.rest_axes(axes, effort)

    @property
    def rests(self) -> tuple[AxisRest, ...]:
        """How each axis ended in the last stop."""
        return self._resting.rests

    @property
    def outcome(self) -> str:
        """How the last stop ended, in words, as far as it was seen."""
        return self._resting.outcome

    def _tick_at_rest(self, efforts: np.ndarray) -> None:
        """Make one tick during a stop; the drives are stopped even when the I/O is lost."""
        self._cyclic.run(efforts.tolist(), self.sample, self._before_sync)
        if self._io is None:
            return
        try:
            self._io.poll_due(self.clock.now())
        except DriverError as error:
            self._io_lost = str(error)
        self._io.update(self.sample)
