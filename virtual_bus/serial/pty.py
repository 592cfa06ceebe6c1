"""A pseudo terminal as a serial line: the device's end, and a path for the other side."""

from __future__ import annotations

import contextlib
import os
import select

from virtual_bus.errors import EmulatorError

READ_BYTES = 4096


class Pty:
    """The device's end of a pseudo terminal in raw mode; `path` is the port the bench opens.

    Raises
    ------
    EmulatorError
        The operating system has no pseudo terminals.
    """

    def __init__(self) -> None:
        if not hasattr(os, "openpty"):
            raise EmulatorError("an emulated serial port needs pseudo terminals, which this system lacks: use Linux, or --bus lockstep:")
        import tty  # not on Windows

        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        # The slave stays open here: otherwise reading fails while no bench is connected.
        self.path = os.ttyname(self._slave)

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none."""
        try:
            return os.read(self._master, READ_BYTES)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send without waiting; what the terminal cannot buffer is lost, as on a line nobody listens to."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def wait(self, timeout_s: float) -> bool:
        """Wait until bytes arrive; return False when none came in time."""
        return bool(select.select([self._master], [], [], timeout_s)[0])

    def close(self) -> None:
        """Close the line."""
        os.close(self._master)
        os.close(self._slave)
