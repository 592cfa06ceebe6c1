"""One CANopen device (CiA 301, CiA 305): NMT, SDO, PDO, SYNC, TIME, heartbeat, guarding, emergency, stored parameters, LSS.

A node owns no bus, and its time is that of its owner. Frames and time go in by `receive` and `tick`, frames come out through `emit`.
Profile devices derive from it and fill in the hooks at the end of the class.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Protocol

import canopen

from virtual_bus.canopen import communication, pdo_rules
from virtual_bus.canopen.clock import ROUNDING_S, Clock
from virtual_bus.canopen.cob_id import CAN_ID, SYNC
from virtual_bus.canopen.emergency import HEARTBEAT_ERROR, Emergency
from virtual_bus.canopen.guarding import Guarding
from virtual_bus.canopen.heartbeat_consumer import HeartbeatConsumer
from virtual_bus.canopen.heartbeat_producer import HeartbeatProducer
from virtual_bus.canopen.lss import REQUEST, UNCONFIGURED, LssSlave
from virtual_bus.canopen.nmt import NMT_COMMANDS, STATE_AFTER, NmtCommand, NmtState
from virtual_bus.canopen.objects import Entry, Objects, Value, key_of
from virtual_bus.canopen.pdo import Rpdo, Tpdo
from virtual_bus.canopen.sdo_server import SdoServer
from virtual_bus.canopen.storage import COMMUNICATION, Storage
from virtual_bus.canopen.sync_producer import SyncProducer
from virtual_bus.canopen.time_stamp import CONSUMES, TIME_BYTES, time_of_day

Emit = Callable[[int, bytes], None]
Handler = Callable[[bytes], None]

_ALL_OBJECTS = range(0x1000, 0x10000)
NMT_BYTES, HEARTBEAT_BYTES, MOST_SYNC_BYTES, SDO_BYTES = 2, 1, 1, 8  # lengths of CiA 301's frames; others are malformed
_SYNC_LENGTH_ERROR, _BUS_OFF_RECOVERED = 0x8240, 0x8140
_AFTER_COMMUNICATION_ERROR = {0: NmtState.PRE_OPERATIONAL, 2: NmtState.STOPPED}  # 1029h:01; 1 keeps the state


class Timed(Protocol):
    """A part of a node with something due at a time."""

    deadline_s: float

    def expire(self, now_s: float) -> None:
        """Do what is due at this time."""


class Node:
    """One device on the bus.

    Parameters
    ----------
    dictionary : canopen.ObjectDictionary
        From `drivers.canopen.eds.load_object_dictionary`.
    node_id : int
        1 to 127; 255 is a device that waits for one over LSS.
    emit : callable
        Takes (CAN identifier, data) of every frame the device sends.
    memory : path, optional
        File of the stored parameters (1010h).
    """

    volatile: frozenset[int] = frozenset()  # indices of process data, never stored
    kept: frozenset[int] = frozenset()  # indices that are stored though the bus cannot write them

    def __init__(self, dictionary: canopen.ObjectDictionary, node_id: int, emit: Emit, memory: Path | None = None) -> None:
        self.node_id = node_id
        self.objects = Objects(dictionary)
        self.emit = self._emit_on_bus = emit
        self.state = NmtState.INITIALISING
        self.clock = Clock()  # its own, or that of the machine it is part of
        self.deadline_s = math.inf  # nothing is due before
        self.resolution_s = 0.0  # of its time: in a machine nobody knows when between two samples a frame came
        self.window_closes_s = math.inf  # synchronous RPDOs that come later wait for no SYNC (1007h)
        self.malformed = 0  # frames dropped because they are none of their protocol
        self.routes: dict[int, Handler] = {}
        self.on_routes: Callable[[], None] = lambda: None  # called when `routes` has been rebuilt
        self._memory = Storage(self.objects, self.volatile, self.kept, memory)
        self.emergency = Emergency(self)
        self._producer = HeartbeatProducer(self)
        self._consumer = HeartbeatConsumer(self)
        self._guarding = Guarding(self)
        self._lss = LssSlave(self, self._memory, dictionary.device_information)
        self._dictionary = dictionary
        self.dictionary_of: Callable[[int], canopen.ObjectDictionary] | None = None  # the data sheet read for another node id
        self.time_stamp: datetime.datetime | None = None  # the last that has come
        self._sync_producer = SyncProducer(self)
        self._sdo = SdoServer(self, self._send_sdo)
        self._rpdos = [Rpdo(self, number) for number in self._pdo_numbers(0x1400, 0x1600)]
        self._tpdos = [Tpdo(self, number) for number in self._pdo_numbers(0x1800, 0x1A00)]
        own = self._consumer, self._guarding, self._producer, self._sync_producer, self.emergency, self._sdo
        self._own_timed: tuple[Timed, ...] = own
        self._timed: tuple[Timed, ...] = own  # and the PDOs that are alive
        self._install_rules()
        self._sync_rpdos: list[Rpdo] = []
        self._sync_tpdos: list[Tpdo] = []
        self._sync_senders: list[Callable[[int | None], None]] = []
        self._event_tpdos: list[Tpdo] = []
        self._sync_length = 0
        self._window_s = math.inf

    def _pdo_numbers(self, communication_base: int, mapping_base: int) -> list[int]:
        return [n for n in range(512) if communication_base + n in self.objects and mapping_base + n in self.objects]

    def _install_rules(self) -> None:
        communication.install(self.objects)
        for rpdo in self._rpdos:
            pdo_rules.install(self.objects, rpdo.communication, rpdo.mapping, receive=True, changed=self._configure)
        for tpdo in self._tpdos:
            pdo_rules.install(self.objects, tpdo.communication, tpdo.mapping, receive=False, changed=self._configure)
        for index in (0x1005, 0x1019):
            self.objects.effects[key_of(index)] = lambda value: self._sync_settings_changed()
        self.objects.effects[key_of(0x1007)] = lambda value: self._configure()
        self.objects.effects[key_of(0x1012)] = lambda value: self.routes_changed()

    def _sync_settings_changed(self) -> None:
        self._sync_producer.start()
        self._configure()

    # ---- life -----------------------------------------------------------------------------------------
    def factory_setting(self, index: int, subindex: int, value: Value) -> None:
        """Set what this very device left the factory with, in place of the data sheet's default, where it has the object."""
        if (entry := self.objects.get(index, subindex)) is not None:
            entry.default = entry.value = value

    def connect(self, emit: Emit) -> None:
        """Set where frames go."""
        self.emit = self._emit_on_bus = emit

    def power_on(self, now_s: float) -> None:
        """Initialise, boot up, and wait in pre-operational."""
        self.clock.now_s = now_s
        self._reset(_ALL_OBJECTS)

    def _reset(self, indices: range) -> None:
        self.state = NmtState.INITIALISING
        self._take_node_id(self._lss.node_id)
        self._memory.reset(indices)
        self._sdo.reset()
        self.emergency.reset(application=indices is _ALL_OBJECTS)
        self.deadline_s = math.inf
        if indices is _ALL_OBJECTS:
            self.application_reset()
        self._consumer.reset()
        self._guarding.reset()
        for rpdo in self._rpdos:
            rpdo.forget()
        if self.node_id == UNCONFIGURED:
            self._configure()
            return
        self.emit(0x700 + self.node_id, bytes((NmtState.INITIALISING,)))
        self._enter(NmtState.PRE_OPERATIONAL)
        self._producer.start(at_once=False)
        self._sync_producer.start()

    def _take_node_id(self, node_id: int) -> None:
        if node_id == self.node_id:
            return
        self.node_id = node_id
        if self.dictionary_of is not None:
            before, self._dictionary = self._dictionary, self.dictionary_of(node_id)
            self.objects.take_defaults(before, self._dictionary)

    def leave_unconfigured(self) -> None:
        """Boot with the node id that has been given over LSS."""
        self._reset(_ALL_OBJECTS)

    def bus_off(self) -> None:
        """Take the CAN controller off the bus: nothing goes in or out until `bus_on`."""
        self.emit = lambda can_id, data: None
        self.routes = {}
        self.on_routes()
        self._communication_error("bus_off")

    def bus_on(self) -> None:
        """Put the CAN controller back on the bus."""
        self.emit = self._emit_on_bus
        self._configure()
        self.emergency.raise_error(_BUS_OFF_RECOVERED)
        self.emergency.clear_error(_BUS_OFF_RECOVERED)

    @property
    def event_driven(self) -> bool:
        """Whether a TPDO waits for a value to change: such a device needs a `tick` every sample."""
        return bool(self._event_tpdos)

    @property
    def has_lss(self) -> bool:
        """Whether the device takes a node id over LSS."""
        return self._lss.supported

    @property
    def may_tell(self) -> bool:
        """Whether emergency messages are allowed in this state."""
        return self.state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)

    # ---- time -----------------------------------------------------------------------------------------
    def after(self, seconds: float) -> float:
        """Return the time [s] that much later."""
        return self.clock.now_s + seconds - ROUNDING_S

    def schedule(self, deadline_s: float) -> None:
        """Ask for a tick by then."""
        if deadline_s < self.deadline_s:
            self.deadline_s = deadline_s
            if deadline_s < self.clock.due_s:
                self.clock.due_s = deadline_s

    def tick(self, now_s: float) -> None:
        """Move time on to `now_s` and send what is due by then."""
        self.clock.now_s = now_s
        if now_s >= self.deadline_s:
            self.deadline_s = math.inf
            self._consumer.expire(now_s)  # it looks at its nodes anew whenever something else is due
            for part in self._timed:
                if now_s >= part.deadline_s:
                    part.expire(now_s)
            self.deadline_s = min([part.deadline_s for part in self._timed])
        for tpdo in self._event_tpdos:
            tpdo.check_event()

    def after_sync(self, entry: Entry) -> Value:
        """Return what this entry will hold once the next SYNC has applied what came since the last."""
        for rpdo in self._sync_rpdos:
            if (value := rpdo.pending(entry)) is not None:
                return value
        return entry.value

    # ---- frames ---------------------------------------------------------------------------------------
    def receive(self, can_id: int, data: bytes, now_s: float) -> None:
        """Take one data frame from the bus."""
        self.clock.now_s = now_s
        handler = self.routes.get(can_id)
        if handler is not None:
            handler(data)

    def receive_remote(self, can_id: int, now_s: float) -> None:
        """Take one remote frame from the bus: that of a guarding master is answered, others are not."""
        self.clock.now_s = now_s
        if can_id == 0x700 + self.node_id and self.routes and self.state is not NmtState.INITIALISING:
            self._guarding.asked()

    def sync(self, data: bytes) -> None:
        """Answer a SYNC, for a device that stands alone: apply what has come, then send what is mapped."""
        if len(data) > MOST_SYNC_BYTES:
            self.malformed += 1
            return
        self.begin_sync(data)
        self.end_sync(data[0] if data else None)

    def begin_sync(self, data: bytes) -> None:
        """Apply synchronous RPDOs: the first half of a SYNC."""
        if len(data) != self._sync_length:
            self.emergency.raise_error(_SYNC_LENGTH_ERROR)
            self.emergency.clear_error(_SYNC_LENGTH_ERROR)
        for rpdo in self._sync_rpdos:
            rpdo.on_sync()
        if self._window_s < math.inf:
            self.window_closes_s = self.clock.now_s + max(self._window_s, self.resolution_s)

    def end_sync(self, counter: int | None) -> None:
        """Send the synchronous TPDOs: the second half of a SYNC, when the actual values are in the dictionary."""
        for send in self._sync_senders:
            send(counter)
        for tpdo in self._event_tpdos:
            tpdo.check_event()

    @property
    def takers(self) -> list[Callable[[], None]]:
        """What the first half of a SYNC without a counter comes to, in order; it holds until `on_routes` is called."""
        if self._sync_length or self._window_s < math.inf:
            return [partial(self.begin_sync, b"")]
        return [rpdo.on_sync for rpdo in self._sync_rpdos]

    @property
    def senders(self) -> list[Callable[[int | None], None]]:
        """What the second half of a SYNC comes to, in order; it holds until `on_routes` is called."""
        return [self.end_sync] if self._event_tpdos else self._sync_senders

    def rehearse(self) -> None:
        """Prepare the answer to a SYNC without sending it, so that its code and data are at hand; nothing changes."""
        for tpdo in self._sync_tpdos:
            tpdo.rehearse()

    def _on_nmt(self, data: bytes) -> None:
        if len(data) != NMT_BYTES or data[0] not in NMT_COMMANDS:
            self.malformed += 1
            return
        if data[1] not in (0, self.node_id):
            return
        command = NmtCommand(data[0])
        if command is NmtCommand.RESET_NODE:
            self.connection_lost("reset")
            self._reset(_ALL_OBJECTS)
        elif command is NmtCommand.RESET_COMMUNICATION:
            self.connection_lost("reset")
            self._reset(COMMUNICATION)
        else:
            self._enter(STATE_AFTER[command])
            if command is NmtCommand.STOP:
                self.connection_lost("stopped")

    def _on_sdo(self, data: bytes) -> None:
        if len(data) != SDO_BYTES:
            self.malformed += 1
            return
        self._sdo.receive(data)
        for tpdo in self._event_tpdos:
            tpdo.check_event()

    def _send_sdo(self, data: bytes) -> None:
        self.emit(0x580 + self.node_id, data)

    def _on_time(self, data: bytes) -> None:
        if len(data) == TIME_BYTES:
            self.time_stamp = time_of_day(data)
        else:
            self.malformed += 1

    def send_heartbeat(self, toggle: int = 0) -> None:
        """Send the NMT state, with a toggle bit where a guarding master asks."""
        self.emit(0x700 + self.node_id, bytes((self.state | toggle,)))

    # ---- errors ---------------------------------------------------------------------------------------
    def heartbeat_lost(self, node_id: int) -> None:
        """Report that a supervised node, or the guarding master (0), is silent."""
        self.emergency.raise_error(HEARTBEAT_ERROR, bytes((node_id,)))
        self._communication_error("heartbeat")

    def heartbeat_found(self) -> None:
        """Report that one of those is heard again."""
        if not (self._consumer.lost or self._guarding.lost):
            self.emergency.clear_error(HEARTBEAT_ERROR)

    def _communication_error(self, reason: str) -> None:
        self.connection_lost(reason)
        if self.state is NmtState.OPERATIONAL:
            after = _AFTER_COMMUNICATION_ERROR.get(self.objects.number(0x1029, 1))
            if after is not None:
                self._enter(after)

    # ---- state and routes -----------------------------------------------------------------------------
    def _enter(self, state: NmtState) -> None:
        self.state = state
        self._configure()
        for tpdo in self._event_tpdos:
            tpdo.check_event()

    def _configure(self) -> None:
        operational = self.state is NmtState.OPERATIONAL
        for rpdo in self._rpdos:
            rpdo.configure(operational)
        for tpdo in self._tpdos:
            tpdo.configure(operational)
        self._sync_rpdos = [rpdo for rpdo in self._rpdos if rpdo.alive and rpdo.synchronous]
        self._sync_tpdos = [tpdo for tpdo in self._tpdos if tpdo.alive and tpdo.synchronous]
        self._sync_senders = [tpdo.sender for tpdo in self._sync_tpdos]
        self._event_tpdos = [tpdo for tpdo in self._tpdos if tpdo.alive and not tpdo.synchronous]
        self._timed = (*self._own_timed, *(rpdo for rpdo in self._rpdos if rpdo.alive), *(tpdo for tpdo in self._tpdos if tpdo.alive))
        self._sync_length = 1 if self.objects.number(0x1019) else 0
        self._window_s = 1e-6 * self.objects.number(0x1007) or math.inf
        self.window_closes_s = math.inf
        self.routes_changed()

    def routes_changed(self) -> None:
        """Rebuild the table of identifiers this device listens to."""
        self.routes = {REQUEST: self._lss.receive} if self._lss.supported else {}
        if self.node_id == UNCONFIGURED:
            self.on_routes()
            return
        self.routes[0x000] = self._on_nmt
        if self.may_tell:
            self.routes[0x600 + self.node_id] = self._on_sdo
            if (time := self.objects.number(0x1012)) & CONSUMES:
                self.routes[time & CAN_ID] = self._on_time
            if self._rpdos or self._tpdos:
                self.routes[self.objects.number(0x1005, 0, SYNC) & CAN_ID] = self.sync
        for rpdo in self._rpdos:
            if rpdo.alive:
                self.routes[rpdo.cob_id] = both(self.routes[rpdo.cob_id], rpdo.receive) if rpdo.cob_id in self.routes else rpdo.receive
        for node_id in self._consumer.supervised:
            self.routes[0x700 + node_id] = self._heartbeat_handler(node_id)
        self.on_routes()

    def _heartbeat_handler(self, node_id: int) -> Handler:
        def heard(data: bytes) -> None:
            if len(data) == HEARTBEAT_BYTES:
                self._consumer.heard(node_id)
            else:
                self.malformed += 1  # it must not keep a master alive that is gone

        return heard

    # ---- for profile devices --------------------------------------------------------------------------
    def application_reset(self) -> None:
        """Apply the parameters, which have their stored or default values at this point."""

    def commands_lost(self) -> None:
        """React to a receive PDO that is missing: the master is there no more, whoever sends its heartbeat."""
        self.connection_lost("commands")

    def connection_lost(self, reason: str) -> None:
        """React to a lost connection.

        The master is gone ("heartbeat", "bus_off") or has put the node to rest ("stopped", "reset").
        """


def both(first: Handler, second: Handler) -> Handler:
    """Return a handler that hands a frame to two PDOs with the same identifier, one after the other."""

    def handle(data: bytes) -> None:
        first(data)
        second(data)

    return handle
