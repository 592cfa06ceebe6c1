"""A serial line inside this process: two ends, bytes in order, no waiting and nothing in the background."""

from __future__ import annotations

from collections.abc import Callable

CAPACITY_BYTES = 65_536  # what an operating system buffers for a port that nobody reads; further bytes are lost


class PipeEnd:
    """One end of the line, with the methods of `drivers.serial.stream.ByteStream`."""

    def __init__(self) -> None:
        self._received = b""
        self._peer = self
        self.on_data: Callable[[], None] | None = None  # called after bytes have arrived at this end

    def connect(self, peer: PipeEnd) -> None:
        """Join two ends, both ways."""
        self._peer, peer._peer = peer, self

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none."""
        data, self._received = self._received, b""
        return data

    def write(self, data: bytes) -> None:
        """Hand bytes to the other end, which may answer before this returns."""
        peer = self._peer
        waiting = peer._received
        peer._received = waiting + data[: CAPACITY_BYTES - len(waiting)]  # one message on an empty line is handed over without a copy
        if peer.on_data is not None:
            peer.on_data()


def pipe() -> tuple[PipeEnd, PipeEnd]:
    """Return two connected ends: (the bench's, the device's)."""
    bench, device = PipeEnd(), PipeEnd()
    bench.connect(device)
    return bench, device
