"""A serial line at the far end of a TCP connection: a serial device server in raw mode, or an emulator."""

from __future__ import annotations

import socket

from drivers.errors import BusUnavailableError
from drivers.tcp_url import why_not_reached

READ_BYTES = 4096
CONNECT_TIMEOUT_S = 2.0  # a device server on the same network answers within milliseconds


class TcpStream:
    """Bytes to and from `tcp:HOST:PORT`, with the interface of `drivers.serial.stream.ByteStream`.

    Raises
    ------
    BusUnavailableError
        Nobody listens there.
    """

    def __init__(self, url: str, host: str, port: int) -> None:
        self.url = url
        try:
            self._socket = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except OSError as error:
            reason = why_not_reached(error)
            raise BusUnavailableError(f"serial line {url}: {reason}; name a device server that is on and that nobody else uses") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none.

        Raises
        ------
        BusUnavailableError
            The connection is gone.
        """
        try:
            data = self._socket.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise BusUnavailableError(f"serial line {self.url} is gone: {error.strerror or error}") from error
        if not data:
            raise BusUnavailableError(f"serial line {self.url} is gone: the other end hung up")
        return data

    def write(self, data: bytes) -> None:
        """Send without waiting; what the connection cannot buffer is lost, as on a UART without handshake.

        Raises
        ------
        BusUnavailableError
            The connection is gone.
        """
        try:
            self._socket.send(data)
        except BlockingIOError:
            return
        except OSError as error:
            raise BusUnavailableError(f"serial line {self.url} is gone: {error.strerror or error}") from error

    def close(self) -> None:
        """Hang up."""
        self._socket.close()
