"""Scan of a bus for its nodes, their identity and state, without disturbing them: listen, then ask each id for its device type."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import can

from drivers.canopen.identity import describe_device_type, read_identity
from drivers.canopen.network import HEARTBEAT, NMT_STATES, SDO_REQUEST, SDO_RESPONSE, PolledNetwork
from drivers.canopen.sdo import SdoNode
from drivers.errors import DriverError, DuplicateNodeError
from drivers.interface import Clock
from drivers.settings import Identity

LISTEN_S = 1.1  # heartbeats of up to a second are common
ANSWER_S = 0.3
NODE_IDS = range(1, 128)
_ASK_DEVICE_TYPE = bytes((0x40, 0x00, 0x10, 0x00, 0, 0, 0, 0))
NO_IDENTITY = Identity(None, None, None, None)


@dataclass(frozen=True)
class FoundNode:
    """One node that was heard or answered."""

    node_id: int
    device_type: int  # object 1000h, -1 when it gave none
    description: str
    identity: Identity
    nmt_state: str
    name: str  # object 1008h, '' when it has none

    def __str__(self) -> str:
        """Return one line for an operator."""
        fields = (("vendor", self.identity.vendor_id), ("product", self.identity.product_code), ("revision", self.identity.revision_number))
        identity = "".join(f", {name} {value:08X}h" for name, value in fields if value is not None)
        return f"node {self.node_id}: {self.name or 'unnamed'}, {self.description}, {self.nmt_state}{identity}"


def scan_bus(bus: can.BusABC, clock: Clock, listen_s: float = LISTEN_S) -> list[FoundNode]:
    """Listen for heartbeats, ask ids 1 to 127 for their device type, then read identity and name of those that are there.

    Parameters
    ----------
    bus : can.BusABC
        Open bus; it stays open.
    clock : Clock
    listen_s : float
        How long to listen before asking.

    Raises
    ------
    DuplicateNodeError
        Two devices share an id: two answers to one request, or more heartbeats than one device produces.
    BusError
        The bus cannot be used.
    """
    network = PolledNetwork(bus, clock)
    states: dict[int, int] = {}
    beats: Counter[int] = Counter()
    answers: dict[int, list[bytes]] = {}

    def on_heartbeat(can_id: int, data: bytearray, _: float) -> None:
        if data:
            states[can_id - HEARTBEAT] = data[0] & 0x7F
            beats[can_id - HEARTBEAT] += 1

    def on_answer(can_id: int, data: bytearray, _: float) -> None:
        answers.setdefault(can_id - SDO_RESPONSE, []).append(bytes(data))

    for node_id in NODE_IDS:
        network.subscribe(HEARTBEAT + node_id, on_heartbeat)
        network.subscribe(SDO_RESPONSE + node_id, on_answer)
    network.pump_for(listen_s)
    heard = dict(beats)
    for node_id in NODE_IDS:
        network.send_message(SDO_REQUEST + node_id, _ASK_DEVICE_TYPE)
        network.drain()
    network.pump_for(ANSWER_S)
    for node_id in NODE_IDS:
        network.unsubscribe(SDO_RESPONSE + node_id)
    twice = [node_id for node_id, given in answers.items() if len(given) > 1]
    found = [
        _look_at(network, node_id, answers.get(node_id, []), states.get(node_id, -1)) for node_id in sorted(answers.keys() | states.keys())
    ]
    twice += [node_id for node_id in answers.keys() & heard.keys() if _beats_too_often(network, node_id, heard[node_id], listen_s)]
    if twice:
        ids = ", ".join(str(node_id) for node_id in sorted(set(twice)))
        raise DuplicateNodeError(f"node id {ids}: two devices answer to it; give one of them another id (switches or LSS) and scan again")
    return found


def _look_at(network: PolledNetwork, node_id: int, answers: list[bytes], state: int) -> FoundNode:
    nmt_state = NMT_STATES.get(state, "no heartbeat")
    first = answers[0].ljust(8, b"\0") if answers else b"\x80".ljust(8, b"\0")
    if first[0] & 0xE2 != 0x42:  # no expedited upload response: heard but mute, or an abort
        return FoundNode(node_id, -1, "gives no device type", NO_IDENTITY, nmt_state, "")
    device_type = int.from_bytes(first[4:8], "little")
    node = SdoNode(network, node_id, "")
    try:
        identity, name = read_identity(node), node.read_text(0x1008)
    except DriverError:  # answered once and then no more, or answers with aborts: still worth listing
        identity, name = NO_IDENTITY, ""
    finally:
        node.close()
    return FoundNode(node_id, device_type, describe_device_type(device_type), identity, nmt_state, name)


def _beats_too_often(network: PolledNetwork, node_id: int, beats: int, listen_s: float) -> bool:
    """Return whether there are more heartbeats than one device's producer time 1017h explains.

    That reveals two devices of one type, whose equal answers merge on a real bus.
    """
    node = SdoNode(network, node_id, "")
    try:
        period_s = int.from_bytes(node.read_if_present(0x1017) or b"", "little") / 1000.0
    except DriverError:
        return False
    finally:
        node.close()
    return period_s > 0.0 and beats > 1.5 * listen_s / period_s + 2
