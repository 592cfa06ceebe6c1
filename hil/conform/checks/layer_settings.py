"""Layer setting services of CiA 305, where the data sheet says that the node has them. Nothing is stored; the node id stays."""

from __future__ import annotations

import struct

from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import Device
from hil.conform.wire import QUIET_S

CHECKS = Checks("layer settings")
check = CHECKS.check
_REQUEST, _ANSWER = 0x7E5, 0x7E4
_ANSWER_S = 0.5
_ALL_ONES = 0xFFFF_FFFF
_FIELDS = {"vendor id": 1, "product code": 2, "revision number": 3, "serial number": 4}


def _ask(device: Device, data: bytes, timeout_s: float = _ANSWER_S) -> bytes | None:
    device.wire.send(_REQUEST, data.ljust(8, b"\0"))
    frame = device.wire.wait(_ANSWER, timeout_s)
    return None if frame is None else frame.data


def _need(device: Device) -> list[int]:
    """Return the identity; skip the check where the data sheet says nothing of LSS."""
    if not device.dictionary.device_information.LSS_supported:
        raise CheckSkippedError("the data sheet says LSS_Supported=0")
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, which a global switch would reach")
    device.must_reset()
    _switch(device, 0)
    return [device.number(0x1018, subindex) for subindex in _FIELDS.values()]


def _switch(device: Device, state: int) -> None:
    device.wire.send(_REQUEST, bytes((0x04, state)).ljust(8, b"\0"))
    device.wire.listen(0.02)


def _select(device: Device, identity: list[int], timeout_s: float) -> bytes | None:
    answer = None
    for place, number in enumerate(identity):
        answer = _ask(device, struct.pack("<BI", 0x40 + place, number), timeout_s if place == len(identity) - 1 else 0.01)
    return answer


@check("the identity selects the node", "CiA 305, switch state selective")
def selected(device: Device) -> None:
    """Select by the identity."""
    identity = _need(device)
    device.expect(_select(device, identity, _ANSWER_S) == b"\x44".ljust(8, b"\0"), "7E4 44 00 00 00 00 00 00 00")
    _switch(device, 0)


@check("another {} does not select the node", "CiA 305, switch state selective", of=lambda device: list(_FIELDS))
def not_selected(device: Device, which: str) -> None:
    """Select by an identity that differs in one field."""
    identity = _need(device)
    identity[_FIELDS[which] - 1] ^= 1
    answer = _select(device, identity, QUIET_S)
    _switch(device, 0)
    device.expect(answer is None, "silence", device.last_exchange())


@check("in the waiting state, {} is not answered", "CiA 305, LSS states", of=lambda device: ["5Ah", "5Eh", "11h", "13h", "17h"])
def waiting(device: Device, which: str) -> None:
    """Ask a node that waits."""
    _need(device)
    answer = _ask(device, bytes((int(which[:2], 16), device.node_id if which == "11h" else 0)), QUIET_S)
    device.expect(answer is None, "silence")


@check("the {} is told as 1018h has it", "CiA 305, inquire identity", of=lambda device: list(_FIELDS))
def inquire(device: Device, which: str) -> None:
    """Ask for a field."""
    identity = _need(device)
    _switch(device, 1)
    place = _FIELDS[which] - 1
    answer = _ask(device, bytes((0x5A + place,)))
    _switch(device, 0)
    device.expect(
        answer is not None and answer[:5] == struct.pack("<BI", 0x5A + place, identity[place]), f"{identity[place]:08X}h, low byte first"
    )


@check("the node id is told", "CiA 305, inquire node-ID")
def inquire_node(device: Device) -> None:
    """Ask for the node id."""
    _need(device)
    _switch(device, 1)
    answer = _ask(device, b"\x5e")
    _switch(device, 0)
    device.expect(answer is not None and answer[:2] == bytes((0x5E, device.node_id)), f"5E {device.node_id:02X}")


@check("node id {} is refused", "CiA 305, configure node-ID", of=lambda device: [0, 128, 254])
def wrong_node(device: Device, node_id: int) -> None:
    """Give a node id out of range."""
    _need(device)
    _switch(device, 1)
    answer = _ask(device, bytes((0x11, node_id)))
    _ask(device, bytes((0x11, device.node_id)))
    _switch(device, 0)
    device.expect(answer is not None and answer[0] == 0x11 and answer[1] == 1, "11 01: out of range")


@check("the node's own node id is taken", "CiA 305, configure node-ID")
def own_node(device: Device) -> None:
    """Give the node the id that it has."""
    _need(device)
    _switch(device, 1)
    answer = _ask(device, bytes((0x11, device.node_id)))
    _switch(device, 0)
    device.expect(answer is not None and answer[:2] == b"\x11\x00", "11 00")


@check("a bit timing that is none is refused", "CiA 305, configure bit timing parameters")
def wrong_timing(device: Device) -> None:
    """Give an index that the table does not have."""
    _need(device)
    _switch(device, 1)
    answer = _ask(device, bytes((0x13, 0, 200)))
    _switch(device, 0)
    device.expect(answer is not None and answer[0] == 0x13 and answer[1] != 0, "13 01: not supported")


@check("the node is identified by ranges that hold it, and by no others", "CiA 305, identify remote slave")
def identify(device: Device) -> None:
    """Ask for the identity, and for ranges of which one does not hold it."""
    vendor, product, revision, serial = _need(device)
    own = [vendor, product, revision, revision, serial, serial]
    cases = [own, [vendor, product, 0, _ALL_ONES, 0, _ALL_ONES]]
    for place, by in ((0, 1), (1, 1), (2, 1), (3, -1), (4, 1), (5, -1)):
        other = [*own]
        other[place] = own[place] + by
        cases += [other] if 0 <= other[place] <= _ALL_ONES else []
    for case in cases:
        found = case[0] == vendor and case[1] == product and case[2] <= revision <= case[3] and case[4] <= serial <= case[5]
        answer = None
        for place, number in enumerate(case):
            last_s = _ANSWER_S if found else QUIET_S
            answer = _ask(device, struct.pack("<BI", 0x46 + place, number), last_s if place == len(case) - 1 else 0.01)
        device.expect((answer is not None and answer[0] == 0x4F) == found, "4F" if found else "silence")


@check("a node that has a node id does not answer to {}", "CiA 305, fastscan", of=lambda device: ["51h", "4Ch"])
def configured(device: Device, which: str) -> None:
    """Look for nodes without a node id."""
    _need(device)
    answer = _ask(device, struct.pack("<BIBBB", int(which[:2], 16), 0, 128 if which == "51h" else 0, 0, 0), QUIET_S)
    device.expect(answer is None, "silence")
