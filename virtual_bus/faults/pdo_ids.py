"""The COB-IDs of a node's PDOs and what they carry, as its dictionary has them at this instant."""

from __future__ import annotations

from virtual_bus.canopen import cob_id
from virtual_bus.canopen.node import Node
from virtual_bus.canopen.objects import Entry
from virtual_bus.canopen.pdo import mapped_entries

_RPDO, _RPDO_MAPPING, _TPDO, _PDOS = 0x1400, 0x1600, 0x1800, 0x200


def rpdo_ids(node: Node) -> frozenset[int]:
    """Return the identifiers of the receive PDOs that exist."""
    return _ids(node, _RPDO)


def rpdos(node: Node) -> list[tuple[int, list[Entry]]]:
    """Return identifier and mapped entries of each receive PDO that exists, by identifier."""
    found = []
    for number in range(_PDOS):
        can_id = node.objects.number(_RPDO + number, 1, cob_id.INVALID)
        if not can_id & cob_id.INVALID:
            found.append((can_id & cob_id.CAN_ID, mapped_entries(node.objects, _RPDO_MAPPING + number)))
    return sorted(found, key=lambda pdo: pdo[0])


def tpdo_ids(node: Node) -> frozenset[int]:
    """Return the identifiers of the transmit PDOs that exist."""
    return _ids(node, _TPDO)


def _ids(node: Node, base: int) -> frozenset[int]:
    present = (node.objects.number(index, 1, cob_id.INVALID) for index in range(base, base + _PDOS) if index in node.objects)
    return frozenset(value & cob_id.CAN_ID for value in present if not value & cob_id.INVALID)
