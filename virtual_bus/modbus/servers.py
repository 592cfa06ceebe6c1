"""The emulated I/O device on a TCP port or a serial line.

A server has no thread: it serves when it is polled, so that the emulator decides when, and no request delays an answer to a SYNC.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import time
from dataclasses import dataclass, field
from typing import Protocol

from virtual_bus.errors import EmulatorError
from virtual_bus.modbus.framing import RTU_MAX_BYTES, TcpFraming
from virtual_bus.modbus.io_device import EmulatedIo

READ_BYTES = 4096
BACKLOG = 16
RTU_SILENCE_S = 0.00175  # ends a frame; the fixed value above 19200 baud (Modbus over Serial Line V1.02, sec. 2.5.1.1)


class Line(Protocol):
    """The device's end of a serial line. Neither method waits."""

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none."""

    def write(self, data: bytes) -> None:
        """Send bytes."""


@dataclass
class _Client:
    """One connection."""

    line: socket.socket
    framing: TcpFraming = field(default_factory=TcpFraming)


class ModbusTcpServer:
    """The device on `host:port`; port 0 takes any free one.

    Raises
    ------
    EmulatorError
        The port is in use or may not be opened.
    """

    def __init__(self, device: EmulatedIo, host: str = "127.0.0.1", port: int = 0) -> None:
        self._device = device
        try:
            self._listener = socket.create_server((host, port), backlog=BACKLOG)
        except OSError as error:
            reason = os.strerror(error.errno) if error.errno else str(error)
            raise EmulatorError(f"Modbus TCP on {host}:{port}: {reason}; give another port, or 0 for any that is free") from error
        self._listener.setblocking(False)
        self.host = host
        self.port = int(self._listener.getsockname()[1])
        self._ready = selectors.DefaultSelector()
        self._ready.register(self._listener, selectors.EVENT_READ)

    @property
    def url(self) -> str:
        """The address in the form the bench takes."""
        return f"tcp:{self.host}:{self.port}"

    def poll(self, timeout_s: float = 0.0) -> None:
        """Answer what has come, and wait at most `timeout_s` for it."""
        for key, _ in self._ready.select(timeout_s):
            if key.data is None:
                self._accept()
            else:
                self._answer(key.data)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # the client has already gone
            line, _ = self._listener.accept()
            line.setblocking(False)
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._ready.register(line, selectors.EVENT_READ, _Client(line))

    def _answer(self, client: _Client) -> None:
        """Take requests and send answers.

        A client that hangs up, speaks something else or does not take its answers is disconnected.
        """
        try:
            data = client.line.recv(READ_BYTES)
            if data:
                client.line.sendall(self._device.serve_tcp(client.framing, data))
        except OSError:
            data = b""
        if not data or client.framing.broken:
            self._ready.unregister(client.line)
            client.line.close()

    def close(self) -> None:
        """Disconnect all clients and release the port."""
        for key in list(self._ready.get_map().values()):
            assert isinstance(key.fileobj, socket.socket)  # nothing else was registered
            key.fileobj.close()
        self._ready.close()


class ModbusRtuServer:
    """The device on a serial line; what arrives between two silences is one frame. The line stays the caller's."""

    def __init__(self, device: EmulatedIo, line: Line) -> None:
        self._device, self._line = device, line
        self._frame = b""
        self._heard_s = 0.0

    def poll(self) -> None:
        """Take what has come; answer when the line has been silent for long enough since."""
        now_s = time.perf_counter()
        if data := self._line.read():
            self._frame = (self._frame + data)[: RTU_MAX_BYTES + 1]  # one byte too many is enough to be refused
            self._heard_s = now_s
        elif self._frame and now_s - self._heard_s >= RTU_SILENCE_S:
            frame, self._frame = self._frame, b""
            if answer := self._device.serve_rtu(frame):
                self._line.write(answer)
