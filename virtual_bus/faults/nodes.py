"""Faults of any CANopen node: its heartbeat, its PDOs, its NMT state, its place on the bus."""

from __future__ import annotations

from virtual_bus.canopen.nmt import NmtCommand
from virtual_bus.canopen.node import Node
from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine, Frame
from virtual_bus.faults.pdo_ids import tpdo_ids
from virtual_bus.faults.seam import Undo, both

NMT, HEARTBEAT = 0x000, 0x700
NOTHING: list[Frame] = []


def node_of(machine: FaultyMachine, at: str) -> Node:
    """Return a node by its name."""
    return machine.nodes[at]


def heartbeat_lost(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send no heartbeat; everything else goes on."""
    node = node_of(machine, at)
    own = HEARTBEAT + node.node_id
    return machine.said.add(node.node_id, lambda can_id, data: NOTHING if can_id == own else [(can_id, data)])


def pdos_lost(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send no PDO; heartbeats go on."""
    node = node_of(machine, at)
    ids = tpdo_ids(node)
    return machine.said.add(node.node_id, lambda can_id, data: NOTHING if can_id in ids else [(can_id, data)])


def pdos_flicker(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Lose every n-th PDO."""
    node = node_of(machine, at)
    ids, sent = tpdo_ids(node), 0

    def lose(can_id: int, data: bytes) -> list[Frame]:
        nonlocal sent
        if can_id not in ids:
            return [(can_id, data)]
        sent += 1
        return NOTHING if sent % int(values["every"]) == 0 else [(can_id, data)]

    return machine.said.add(node.node_id, lose)


def pdos_delayed(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send each PDO some SYNCs late."""
    node = node_of(machine, at)
    ids = tpdo_ids(node)
    waiting: dict[int, list[bytes]] = {}

    def delay(can_id: int, data: bytes) -> list[Frame]:
        if can_id not in ids:
            return [(can_id, data)]
        queue = waiting.setdefault(can_id, [])
        queue.append(data)
        return [(can_id, queue.pop(0))] if len(queue) > values["syncs"] else NOTHING

    return machine.said.add(node.node_id, delay)


def pdos_frozen(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send the PDOs of one instant again and again: the process image is not updated any more."""
    node = node_of(machine, at)
    ids = tpdo_ids(node)
    then: dict[int, bytes] = {}
    return machine.said.add(node.node_id, lambda can_id, data: [(can_id, then.setdefault(can_id, data) if can_id in ids else data)])


def pdos_short(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send the PDOs one byte short: another mapping than was configured."""
    node = node_of(machine, at)
    ids = tpdo_ids(node)
    return machine.said.add(node.node_id, lambda can_id, data: [(can_id, data[:-1] if can_id in ids else data)])


def pdos_long(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send the PDOs with eight bytes, whatever is mapped."""
    node = node_of(machine, at)
    ids = tpdo_ids(node)
    return machine.said.add(node.node_id, lambda can_id, data: [(can_id, data.ljust(8, b"\0") if can_id in ids else data)])


def setting_changes(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Change an object inside the device, as a maker's tool on its service port does: nothing is on the bus."""
    objects = node_of(machine, at).objects
    entry = objects.find(int(values["index"]), int(values["subindex"]))
    objects.write(entry.index, entry.subindex, entry.encode(int(values["value"])))
    return lambda: None


def leaves_operational(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Fall back to pre-operational by itself."""
    node = node_of(machine, at)
    node.receive(NMT, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, node.node_id)), machine.time_s)
    return lambda: None


def stops(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Go to NMT stopped by itself."""
    node = node_of(machine, at)
    node.receive(NMT, bytes((NmtCommand.STOP, node.node_id)), machine.time_s)
    return lambda: None


def leaves_bus(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Go bus-off: nothing in, nothing out; the device knows it and reacts as it is configured."""
    node = node_of(machine, at)
    node.bus_off()
    return node.bus_on


def unplugged(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Hear and say nothing: the cable is off; the device only misses the master's heartbeat."""
    node = node_of(machine, at)
    return both(
        machine.heard.add(node.node_id, lambda can_id, data: None),
        machine.said.add(node.node_id, lambda can_id, data: NOTHING),
    )


def deaf_to_sync(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Hear no SYNC."""
    node, sync = node_of(machine, at), machine.bus.sync_cob_id
    return machine.heard.add(node.node_id, lambda can_id, data: None if can_id == sync else (can_id, data))


def babbles(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Send its heartbeat many times per SYNC."""
    node = node_of(machine, at)

    def babble() -> None:
        for _ in range(int(values["frames"])):
            node.send_heartbeat()

    return machine.intruders.add("", babble)


INDEX = Parameter("index", "", float(0x605A), float(0x1000), 65_535.0, "of the object", whole=True)
SUBINDEX = Parameter("subindex", "", 0.0, 0.0, 255.0, "of the object", whole=True)
VALUE = Parameter("value", "", 0.0, -(2.0**31), 2.0**32 - 1.0, "that it has from then on", whole=True)
NO_HEARTBEAT_CONSUMER = {"index": float(0x1016), "subindex": 1.0}
NO_ABORT_REACTION = {"index": float(0x6007)}
NO_QUICK_STOP = {"index": float(0x605A)}
SLOW_QUICK_STOP = {"index": float(0x6085), "value": 100.0}
OTHER_MODE = {"index": float(0x6060), "value": 9.0}  # cyclic synchronous velocity, whose target nobody sends

KINDS = (
    FaultKind("heartbeat_lost", "The node sends no heartbeat; its PDOs go on.", "bus", "node", heartbeat_lost,
              trials=(Trial(), Trial(for_s=0.12)), budget="node_silent"),
    FaultKind("pdos_lost", "The node sends no PDO; its heartbeat goes on.", "drive", "node", pdos_lost,
              trials=(Trial(), Trial(for_s=0.008)), budget="position_lost"),
    FaultKind("pdos_flicker", "Every n-th PDO of the node is lost.", "drive", "node", pdos_flicker,
              (Parameter("every", "", 3.0, 2.0, 1e6, "PDO of which the last is lost", whole=True),), budget="position_lost"),
    FaultKind("pdos_delayed", "The node's PDOs come some SYNCs late.", "drive", "node", pdos_delayed,
              (Parameter("syncs", "", 2.0, 1.0, 1000.0, "by which they are late", whole=True),), budget="runaway"),
    FaultKind("pdos_frozen", "The node sends the PDOs of one instant again and again.", "drive", "node", pdos_frozen,
              trials=(Trial(), Trial("settled")), budget="runaway"),
    FaultKind("pdos_short", "The node's PDOs are one byte short.", "bus", "node", pdos_short, budget="position_lost"),
    FaultKind("pdos_long", "The node's PDOs have eight bytes whatever is mapped.", "bus", "short PDO", pdos_long),
    FaultKind("setting_changes", "An object of the drive changes inside it, without a frame on the bus.", "drive", "drive", setting_changes,
              (INDEX, SUBINDEX, VALUE),
              (Trial("settled", NO_QUICK_STOP), Trial("settled", SLOW_QUICK_STOP), Trial("settled", NO_HEARTBEAT_CONSUMER))),
    FaultKind("node_leaves_operational", "The node falls back to pre-operational by itself.", "drive", "node", leaves_operational,
              budget="bench_silent"),
    FaultKind("node_stops", "The node goes to NMT stopped by itself.", "drive", "node", stops, budget="bench_silent"),
    FaultKind("node_bus_off", "The node's CAN controller goes bus-off.", "bus", "node", leaves_bus, trials=(Trial(), Trial(for_s=0.3)),
              budget="bench_silent"),
    FaultKind("node_unplugged", "The node's CAN cable is off: it hears and says nothing.", "bus", "node", unplugged, budget="bench_silent"),
    FaultKind("node_deaf_to_sync", "The node hears no SYNC.", "bus", "node", deaf_to_sync, budget="position_lost"),
    FaultKind("node_babbles", "The node sends many heartbeats per SYNC.", "bus", "node", babbles,
              (Parameter("frames", "", 50.0, 1.0, 10_000.0, "per SYNC", whole=True),)),
)  # fmt: skip
