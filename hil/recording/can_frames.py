"""CAN frames of a log."""

from __future__ import annotations

from typing import NamedTuple


class CanFrame(NamedTuple):
    """One frame of a log; error frames, which are no frames of the bus, are left out by the readers."""

    time_s: float  # since the log's own origin of time
    channel: str
    can_id: int
    extended: bool
    remote: bool
    data: bytes
