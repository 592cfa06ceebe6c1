"""Who is on a bus: against scripted nodes, and against the `canopen` library's own nodes on python-can's virtual bus."""

from __future__ import annotations

import uuid

import can
import canopen
import pytest
from scripted_nodes import EDS, BusClock, ScriptedBus, ScriptedDrive, ScriptedEncoder, ScriptedNode

from drivers.canopen.scan import FoundNode, scan_bus
from drivers.errors import DuplicateNodeError
from drivers.settings import Identity
from hil.bench.clock import WallClock


def scan(*nodes: ScriptedNode) -> list[FoundNode]:
    bus = ScriptedBus(*nodes)
    return scan_bus(bus, BusClock(bus))


def test_nodes_are_found_with_type_identity_state_and_name() -> None:
    drive = ScriptedDrive(3)
    drive.set(0x1017, 0, 100)
    drive.state = 0x05
    encoder = ScriptedEncoder(12, drive)
    found = scan(drive, encoder)
    assert [(node.node_id, node.description, node.nmt_state, node.name) for node in found] == [
        (3, "servo drive (CiA 402)", "operational", "Scripted drive"),
        (12, "encoder (CiA 406)", "no heartbeat", "Scripted encoder"),
    ]
    assert found[0].identity == Identity(0, 0x49534F01, 0x10000, None)
    assert str(found[0]) == (
        "node 3: Scripted drive, servo drive (CiA 402), operational, vendor 00000000h, product 49534F01h, revision 00010000h"
    )


def test_scanning_commands_nothing() -> None:
    drive = ScriptedDrive(3)
    bus = ScriptedBus(drive)
    scan_bus(bus, BusClock(bus))
    requests = [(can_id, data[0]) for _, can_id, data in bus.log if can_id < 0x580 or can_id >= 0x600]
    assert all(0x601 <= can_id <= 0x67F and command in (0x40, 0x60, 0x70) for can_id, command in requests)  # uploads only


def test_a_node_that_only_beats_is_listed() -> None:
    mute = ScriptedDrive(9)
    mute.answers_sdo = False
    mute.set(0x1017, 0, 500)
    (node,) = scan(mute)
    assert (node.node_id, node.device_type, node.nmt_state) == (9, -1, "pre-operational")


def test_an_empty_bus_has_nobody() -> None:
    assert scan() == []


def test_two_answers_to_one_request_are_a_duplicate() -> None:
    with pytest.raises(DuplicateNodeError, match="node id 5: two devices"):
        scan(ScriptedDrive(5), ScriptedDrive(5), ScriptedDrive(6))


def test_twice_the_heartbeats_are_a_duplicate_even_when_answers_merge() -> None:
    class Shadow(ScriptedDrive):
        """Sends the same bits at the same time as its twin: on a real bus its answers are not seen apart."""

        def _sdo(self, data: bytes) -> None:
            pass

    first, second = ScriptedDrive(5), Shadow(5)
    for k, node in enumerate((first, second)):
        node.set(0x1017, 0, 100)
        node._beat_s = -0.05 * k
    with pytest.raises(DuplicateNodeError, match="node id 5"):
        scan(first, second)


def test_the_canopen_librarys_own_nodes_are_found_on_a_virtual_bus() -> None:
    channel = uuid.uuid4().hex
    network = canopen.Network(can.Bus(interface="virtual", channel=channel))
    network.connect()
    try:
        network.create_node(11, str(EDS / "isocenter_encoder.eds"))
        network.create_node(42, str(EDS / "isocenter_drive.eds"))
        with can.Bus(interface="virtual", channel=channel) as bus:
            found = scan_bus(bus, WallClock(), listen_s=0.01)
    finally:
        network.disconnect()
    assert [(node.node_id, node.name) for node in found] == [(11, "Isocenter encoder"), (42, "Isocenter drive")]
