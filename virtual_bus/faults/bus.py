"""Faults of the CAN bus: foreign participants, frames that are no good, and a bus that carries nothing."""

from __future__ import annotations

import struct
from collections.abc import Callable

from virtual_bus.canopen.nmt import NmtCommand, NmtState
from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine, Frame
from virtual_bus.faults.nodes import (
    INDEX,
    NO_ABORT_REACTION,
    NO_HEARTBEAT_CONSUMER,
    NO_QUICK_STOP,
    OTHER_MODE,
    SLOW_QUICK_STOP,
    SUBINDEX,
    VALUE,
    node_of,
)
from virtual_bus.faults.pdo_ids import rpdos, tpdo_ids
from virtual_bus.faults.seam import Undo, both
from virtual_bus.special_frames import ERROR, ERROR_BUS_ERROR, ERROR_BUS_OFF, ERROR_BYTES, EXTENDED, REMOTE

NMT, SDO_REQUEST, HEARTBEAT = 0x000, 0x600, 0x700
FLOOD_ID = 0x7F0  # of lower priority than everything CANopen uses
URGENT_ID = 0x001  # of higher priority than everything but NMT
EVERY = Parameter("every", "", 1.0, 1.0, 1e6, "SYNC in which it sends", whole=True)
MASTER = Parameter("node", "", 127.0, 1.0, 127.0, "node id of the master", whole=True)
NOTHING: list[Frame] = []


def foreign_sync(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let somebody else send SYNCs too: the devices answer each of them."""
    return _every(machine, values, lambda: machine.intrude(machine.bus.sync_cob_id, b""))


def sync_stops(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let the device that sends SYNC fall silent."""
    return machine.produced.add("", lambda: False)


def foreign_tpdo(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let somebody else send a node's PDOs, with zeros, just before or behind each of the node."""
    node = node_of(machine, at)
    ids, sent = tpdo_ids(node), 0

    def join(can_id: int, data: bytes) -> list[Frame]:
        nonlocal sent
        sent += can_id in ids
        if can_id not in ids or sent % int(values["every"]):
            return [(can_id, data)]
        foreign = (can_id, bytes(len(data)))
        return [(can_id, data), foreign] if values["behind"] else [foreign, (can_id, data)]

    return machine.said.add(node.node_id, join)


def foreign_heartbeat(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let somebody else send a node's heartbeat."""
    node = node_of(machine, at)
    return _every(machine, values, lambda: machine.intrude(HEARTBEAT + node.node_id, bytes((int(values["state"]),))))


def foreign_master(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let somebody else send the master's heartbeat."""
    can_id = HEARTBEAT + int(values["node"])
    return _every(machine, values, lambda: machine.intrude(can_id, bytes((NmtState.OPERATIONAL,))))


def foreign_torque(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let somebody else command a drive too: operation enabled and a torque, after each frame of the master; other targets stay."""
    node, torque = machine.drives[at], round(values["torque"])
    asked = {0x6040: 0x000F, 0x6071: torque, 0x60B2: torque}

    def send() -> None:
        for can_id, entries in rpdos(node):
            machine.intrude(can_id, b"".join(entry.encode(asked.get(entry.index, entry.value)) for entry in entries))

    return _every(machine, values, send)


def foreign_nmt(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let somebody else command a node's NMT state, once."""
    machine.intrude(NMT, bytes((int(values["command"]), node_of(machine, at).node_id)))
    return lambda: None


def foreign_sdo(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let somebody else write an object of a drive over SDO, once, or read it."""
    node = machine.drives[at]
    index, subindex = int(values["index"]), int(values["subindex"])
    if values["reads"]:
        command, data = 0x40, b""
    else:
        data = node.objects.find(index, subindex).encode(int(values["value"]))
        command = 0x23 | 4 - len(data) << 2
    machine.intrude(SDO_REQUEST + node.node_id, struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0"))
    return lambda: None


def flooded(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Put many frames that mean nothing on the bus."""

    def flood() -> None:
        for number in range(int(values["frames"])):
            machine.put(int(values["id"]), number.to_bytes(8, "little"))

    return machine.intruders.add("", flood)


def wrong_length(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Put empty frames with the identifiers of a node's PDOs on the bus."""
    ids = sorted(tpdo_ids(node_of(machine, at)))
    return _special(machine, values, [(can_id, b"") for can_id in ids])


def remote_frames(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Put remote frames with the identifiers of a node's PDOs on the bus."""
    ids = sorted(tpdo_ids(node_of(machine, at)))
    return _special(machine, values, [(can_id | REMOTE, bytes(8)) for can_id in ids])


def extended_frames(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Put 29-bit frames with the numbers of a node's PDOs on the bus."""
    ids = sorted(tpdo_ids(node_of(machine, at)))
    return _special(machine, values, [(can_id | EXTENDED, bytes(8)) for can_id in ids])


def error_frames(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let the master's controller report bus errors."""
    return _special(machine, values, [(ERROR | ERROR_BUS_ERROR, bytes(ERROR_BYTES))])


def silent(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Carry nothing either way: a short, or a plug that is off."""
    return both(machine.wire.add("in", lambda can_id, data: NOTHING), machine.wire.add("out", lambda can_id, data: NOTHING))


def bus_off(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let the master's controller report bus-off and carry nothing from then on."""
    machine.put(ERROR | ERROR_BUS_OFF, bytes(ERROR_BYTES))
    return silent(machine, at, values)


def loses_frames(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Lose a share of all frames, either way."""
    numbers = machine.random("bus_loses_frames")

    def lose(can_id: int, data: bytes) -> list[Frame]:
        return NOTHING if numbers.random() < values["share"] else [(can_id, data)]

    return both(machine.wire.add("in", lose), machine.wire.add("out", lose))


def repeats_frames(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Bring every frame of the devices twice: a sender that saw no end of frame repeats it."""
    return machine.wire.add("out", lambda can_id, data: [(can_id, data), (can_id, data)])


def one_way(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Carry the devices' frames only: the master's transmitter is broken."""
    return machine.wire.add("in", lambda can_id, data: NOTHING)


def _every(machine: FaultyMachine, values: Values, send: Callable[[], None]) -> Undo:
    count = 0

    def perhaps() -> None:
        nonlocal count
        count += 1
        if count % int(values["every"]) == 0:
            send()

    return machine.intruders.add("", perhaps)


def _special(machine: FaultyMachine, values: Values, frames: list[Frame]) -> Undo:
    def send() -> None:
        for can_id, data in frames:
            machine.put(can_id, data)

    return _every(machine, values, send)


KINDS = (
    FaultKind("foreign_sync", "Somebody else sends SYNCs too; the devices answer each.", "bus", "bus", foreign_sync, (EVERY,),
              (Trial(), Trial(values={"every": 10.0}), Trial("start"))),
    FaultKind("sync_stops", "The device that sends SYNC, where the bench does not, falls silent.", "bus", "producer", sync_stops,
              trials=(Trial(), Trial("settled"), Trial("start"), Trial(for_s=0.02)), budget="bench_silent"),
    FaultKind("foreign_tpdo", "Somebody else sends the node's PDOs, with zeros.", "bus", "node", foreign_tpdo,
              (EVERY, Parameter("behind", "", 1.0, 0.0, 1.0, "1: behind the node's own PDO, 0: before it", whole=True)),
              (Trial(), Trial(values={"behind": 0.0}), Trial(values={"every": 50.0})), budget="runaway"),
    FaultKind("foreign_heartbeat", "Somebody else sends the node's heartbeat.", "bus", "node", foreign_heartbeat,
              (Parameter("every", "", 25.0, 1.0, 1e6, "SYNC in which it sends", whole=True),
               Parameter("state", "", 5.0, 0.0, 127.0, "NMT state it tells", whole=True)),
              (Trial(), Trial(values={"state": 127.0}))),
    FaultKind("foreign_master", "Somebody else sends the master's heartbeat.", "bus", "bus", foreign_master,
              (Parameter("every", "", 25.0, 1.0, 1e6, "SYNC in which it sends", whole=True), MASTER), (Trial(), Trial("start"))),
    FaultKind("foreign_torque", "Somebody else commands the drive's torque too.", "bus", "drive", foreign_torque,
              (EVERY, Parameter("torque", "", 800.0, -32768.0, 32767.0, "target, per mille of the rated", whole=True)), budget="runaway"),
    FaultKind("foreign_nmt", "Somebody else commands the node's NMT state.", "bus", "node", foreign_nmt,
              (Parameter("command", "", float(NmtCommand.STOP), 0.0, 255.0, "NMT command specifier", whole=True),),
              (Trial(), Trial(values={"command": float(NmtCommand.RESET_NODE)})), budget="bench_silent"),
    FaultKind("foreign_sdo", "Somebody else writes an object of the drive over SDO, or reads it.", "bus", "drive", foreign_sdo,
              (INDEX, SUBINDEX, VALUE, Parameter("reads", "", 0.0, 0.0, 1.0, "1: it is read only", whole=True)),
              (Trial(values={"reads": 1.0}),
               *(Trial(values=written, brake=brake, killed=killed)
                 for written in (NO_HEARTBEAT_CONSUMER, NO_ABORT_REACTION, NO_QUICK_STOP, SLOW_QUICK_STOP, OTHER_MODE)
                 for brake in ("good", "absent") for killed in (False, True)))),
    FaultKind("bus_flooded", "The bus carries many frames that mean nothing.", "bus", "bus", flooded,
              (Parameter("frames", "", 64.0, 1.0, 10_000.0, "per SYNC", whole=True),
               Parameter("id", "", float(FLOOD_ID), 0.0, 2047.0, "their identifier", whole=True)),
              (Trial(), Trial(values={"id": float(URGENT_ID)})), budget="bench_silent"),
    FaultKind("frames_empty", "Empty frames with the node's PDO identifiers are on the bus.", "bus", "node", wrong_length, (EVERY,)),
    FaultKind("frames_remote", "Remote frames with the node's PDO identifiers are on the bus.", "bus", "node", remote_frames, (EVERY,)),
    FaultKind("frames_extended", "Frames whose 29-bit identifiers are the numbers of the node's PDOs are on the bus.", "bus", "node",
              extended_frames, (EVERY,)),
    FaultKind("error_frames", "The master's controller reports bus errors.", "bus", "bus", error_frames, (EVERY,)),
    FaultKind("bus_silent", "The bus carries nothing.", "bus", "bus", silent, trials=(Trial(), Trial("settled"), Trial(for_s=0.05)),
              budget="bench_silent"),
    FaultKind("bus_off", "The master's controller reports bus-off; nothing is carried from then on.", "bus", "bus", bus_off,
              budget="bench_silent"),
    FaultKind("bus_one_way", "The devices hear nothing of the master; the master hears them.", "bus", "bus", one_way,
              budget="bench_silent"),
    FaultKind("bus_loses_frames", "A share of all frames is lost.", "bus", "bus", loses_frames,
              (Parameter("share", "", 0.02, 0.0, 1.0, "of the frames"),), budget="position_lost"),
    FaultKind("bus_repeats_frames", "Every frame of the devices comes twice.", "bus", "bus", repeats_frames),
)  # fmt: skip
