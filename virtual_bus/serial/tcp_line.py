"""A serial line on a TCP port of this host, as behind a serial device server: the device's end."""

from __future__ import annotations

import contextlib
import socket

READ_BYTES = 4096


class TcpLine:
    """Bytes to and from whoever is connected to `url`. Nothing waits.

    One client at a time is served; a second one is disconnected.
    """

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self.url = f"tcp:127.0.0.1:{self._listener.getsockname()[1]}"
        self._line: socket.socket | None = None

    @property
    def connected(self) -> bool:
        """Whether a client was there at the last `read`."""
        return self._line is not None

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none.

        A client that has hung up is let go, and the next one is taken.
        """
        data = self._received() if self._line is not None else b""
        with contextlib.suppress(OSError):  # there is no caller
            caller, _ = self._listener.accept()
            if self._line is not None:
                caller.close()
            else:
                caller.setblocking(False)
                caller.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._line = caller
        return data

    def _received(self) -> bytes:
        assert self._line is not None
        try:
            data = self._line.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> None:
        """Send without waiting; what cannot be buffered is lost, as on a line nobody listens to."""
        if self._line is not None:
            with contextlib.suppress(OSError):
                self._line.send(data)

    def close(self) -> None:
        """Disconnect the client and release the port."""
        self._hang_up()
        self._listener.close()

    def _hang_up(self) -> None:
        if self._line is not None:
            self._line.close()
            self._line = None
