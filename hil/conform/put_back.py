"""Putting back what a node held before the checks: PDOs by their procedure, the rest by plain writes."""

from __future__ import annotations

from canopen.objectdictionary import ODVariable

from hil.conform.device import INVALID, Device, Pdo
from hil.conform.transfers import download

Values = dict[tuple[int, int], bytes]
_OWN_RULES = (0x1003, 0x1010, 0x1011)
_PDO_OBJECTS = range(0x1400, 0x1C00)
_COUNT, _COB_ID = 0, 1


def values_of(device: Device, entries: list[ODVariable]) -> Values:
    """Read the entries that can be read."""
    values = {}
    for entry in entries:
        if entry.index not in _OWN_RULES and isinstance(value := device.try_read(entry.index, entry.subindex), bytes):
            values[entry.index, entry.subindex] = value
    return values


def put_back(device: Device, before: Values) -> list[str]:
    """Write what differs; return in words what could not be."""
    differing = {key for key, value in before.items() if device.try_read(*key) != value}
    for pdo in device.pdos(receive=True) + device.pdos(receive=False):
        if any(index in (pdo.communication, pdo.mapping) for index, _ in differing):
            _put_pdo_back(device, pdo, before)
    for key in sorted(differing):
        if key[0] not in _PDO_OBJECTS:
            download(device.wire, *key, before[key])
    return [_said(key, before[key]) for key in sorted(differing) if device.try_read(*key) != before[key]]


def _said(key: tuple[int, int], value: bytes) -> str:
    return f"{key[0]:04X}h:{key[1]:02X} held {value.hex(' ').upper()}"


def _put_pdo_back(device: Device, pdo: Pdo, before: Values) -> None:
    wire = device.wire
    communication = {sub: value for (index, sub), value in before.items() if index == pdo.communication}
    mapping = {sub: value for (index, sub), value in before.items() if index == pdo.mapping}
    cob_id = communication.pop(_COB_ID, None)
    if cob_id is None:
        return
    number = int.from_bytes(cob_id, "little")
    download(wire, pdo.communication, _COB_ID, (number | INVALID).to_bytes(4, "little"))
    count = mapping.pop(_COUNT, None)
    if count is not None and mapping:
        download(wire, pdo.mapping, _COUNT, b"\0")
        for sub, value in sorted(mapping.items()):
            download(wire, pdo.mapping, sub, value)
        download(wire, pdo.mapping, _COUNT, count)
    for sub, value in sorted(communication.items()):
        if sub:
            download(wire, pdo.communication, sub, value)
    download(wire, pdo.communication, _COB_ID, cob_id)
