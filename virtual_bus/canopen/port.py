"""What the parts of a CANopen node ask of the node they are in: objects, time, and a way onto the bus."""

from __future__ import annotations

from typing import Protocol

from virtual_bus.canopen.objects import Objects


class Errors(Protocol):
    """Where a part tells what went wrong (`virtual_bus.canopen.emergency.Emergency`)."""

    def raise_error(self, code: int, manufacturer: bytes = b"") -> None:
        """Tell of an error that has come up."""

    def clear_error(self, code: int) -> None:
        """Tell that an error is gone."""


class Port(Protocol):
    """A node as its parts see it (`virtual_bus.canopen.node.Node`)."""

    now_s: float

    @property
    def objects(self) -> Objects:
        """The node's object dictionary."""

    @property
    def emergency(self) -> Errors:
        """Its errors."""

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
        """Say that the identifiers listened to are others."""

    def send_heartbeat(self) -> None:
        """Send the NMT state."""

    def heartbeat_lost(self, node_id: int) -> None:
        """Say that a supervised node is silent."""

    def sync(self, data: bytes) -> None:
        """Follow a SYNC of our own."""
