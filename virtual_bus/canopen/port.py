"""What the parts of a CANopen node need of the node: objects, time, and a way onto the bus."""

from __future__ import annotations

from typing import Protocol

from virtual_bus.canopen.clock import Clock
from virtual_bus.canopen.objects import Objects


class Errors(Protocol):
    """The errors of a node, as its parts report them (`virtual_bus.canopen.emergency.Emergency`)."""

    def raise_error(self, code: int, manufacturer: bytes = b"") -> None:
        """Report an error that has come up."""

    def clear_error(self, code: int) -> None:
        """Report that an error is gone."""


class Port(Protocol):
    """A node as its parts see it (`virtual_bus.canopen.node.Node`)."""

    clock: Clock
    deadline_s: float
    window_closes_s: float

    @property
    def objects(self) -> Objects:
        """The node's object dictionary."""

    @property
    def emergency(self) -> Errors:
        """The node's errors."""

    @property
    def may_tell(self) -> bool:
        """Whether emergency messages and SYNC are allowed in this state."""

    def emit(self, can_id: int, data: bytes, /) -> None:
        """Send a frame."""

    def after(self, seconds: float) -> float:
        """Return the time [s] that much later."""

    def schedule(self, deadline_s: float) -> None:
        """Ask for a tick by then."""

    def routes_changed(self) -> None:
        """Report that the identifiers listened to have changed."""

    def send_heartbeat(self, toggle: int = 0) -> None:
        """Send the NMT state, with a toggle bit where a guarding master asks."""

    def heartbeat_lost(self, node_id: int) -> None:
        """Report that a supervised node, or the guarding master (0), is silent."""

    def heartbeat_found(self) -> None:
        """Report that one of those is heard again."""

    def commands_lost(self) -> None:
        """React to a receive PDO that is missing."""

    def sync(self, data: bytes) -> None:
        """Answer a SYNC that the node sent itself."""
