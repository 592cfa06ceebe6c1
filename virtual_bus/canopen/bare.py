"""A bare CiA 301 device from any EDS: parameters, PDO rules, SYNC, heartbeat, emergency; no profile behind it."""

from __future__ import annotations

from pathlib import Path

from drivers.canopen.eds import load_object_dictionary
from virtual_bus.canopen.node import Emit, Node


def bare_device(eds: str | Path, node_id: int, emit: Emit, memory: Path | None = None) -> Node:
    """A device that answers as its data sheet says. Mapped values are what was last written to them.

    Raises
    ------
    drivers.errors.ProtocolError
        The file is no usable EDS or DCF.
    """
    return Node(load_object_dictionary(eds, node_id), node_id, emit, memory)
