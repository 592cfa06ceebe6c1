"""The COB-IDs of a node's PDOs, as its dictionary has them at this instant."""

from __future__ import annotations

from virtual_bus.canopen import cob_id
from virtual_bus.canopen.node import Node

_RPDO, _TPDO, _PDOS = 0x1400, 0x1800, 0x200


def rpdo_ids(node: Node) -> frozenset[int]:
    """Return the identifiers of the receive PDOs that exist."""
    return _ids(node, _RPDO)


def tpdo_ids(node: Node) -> frozenset[int]:
    """Return the identifiers of the transmit PDOs that exist."""
    return _ids(node, _TPDO)


def _ids(node: Node, base: int) -> frozenset[int]:
    present = (node.objects.number(index, 1, cob_id.INVALID) for index in range(base, base + _PDOS) if index in node.objects)
    return frozenset(value & cob_id.CAN_ID for value in present if not value & cob_id.INVALID)
