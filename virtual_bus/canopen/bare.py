"""A bare CiA 301 device from any EDS: parameters, PDO rules, SYNC, heartbeat, emergency; no profile."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from drivers.canopen.eds import load_object_dictionary
from virtual_bus.canopen.node import Emit, Node


def bare_device(eds: str | Path, node_id: int, emit: Emit, memory: Path | None = None) -> Node:
    """Return a device that answers as its data sheet says.

    Its mapped values are what was last written to them.

    Raises
    ------
    drivers.errors.ProtocolError
        The file is no usable EDS or DCF.
    """
    node = Node(load_object_dictionary(eds, node_id), node_id, emit, memory)
    node.dictionary_of = partial(load_object_dictionary, eds)
    return node


class BareMachine:
    """One bare device with a CAN connector and a time of its own, as `virtual_bus.emulator.run_device` takes it."""

    def __init__(self, eds: str | Path, node_id: int, memory: Path | None = None) -> None:
        self.node = bare_device(eds, node_id, lambda can_id, data: None, memory)
        self.time_s = 0.0

    def connect(self, emit: Emit) -> None:
        """Set where frames go."""
        self.node.connect(emit)

    def power_on(self) -> None:
        """Boot."""
        self.node.power_on(self.time_s)

    def receive(self, can_id: int, data: bytes) -> None:
        """Take one data frame from the bus."""
        self.node.receive(can_id, data, self.time_s)

    def receive_remote(self, can_id: int) -> None:
        """Take one remote frame from the bus."""
        self.node.receive_remote(can_id, self.time_s)

    def idle(self, seconds: float) -> None:
        """Let that much time pass."""
        self.time_s += seconds
        self.node.tick(self.time_s)
