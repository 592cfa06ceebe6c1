"""Byte streams that never wait, for the IMU driver."""

from __future__ import annotations

import contextlib
import os
from typing import Protocol

import serial

from drivers.errors import BusUnavailableError
from drivers.serial.tcp_stream import TcpStream
from drivers.serial_port import why_not_opened
from drivers.tcp_url import parse_tcp_url

try:
    import fcntl
    import termios
except ImportError:  # on Windows, which needs neither
    fcntl = termios = None  # type: ignore[assignment]

READ_BYTES = 4096


class ByteStream(Protocol):
    """One end of a serial line. Neither method waits."""

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none."""

    def write(self, data: bytes) -> None:
        """Send bytes; those that do not fit the buffer are lost, as on a UART without handshake."""


def open_stream(device: str, baud: int) -> SerialStream | TcpStream:
    """Open the line to a serial device: a port of this computer, or `tcp:HOST:PORT` of a device server.

    Raises
    ------
    BusUnavailableError
        The device does not exist, is in use, or its address is invalid.
    """
    if not device.startswith("tcp:"):
        return SerialStream(device, baud)
    address = parse_tcp_url(device)
    if address is None:
        raise BusUnavailableError(f"serial line {device}: a device server's reads tcp:HOST:PORT, e.g. tcp:192.168.0.5:4001")
    return TcpStream(device, *address)


class SerialStream:
    """A serial port or pseudo terminal in raw mode.

    Raises
    ------
    BusUnavailableError
        The port does not exist, is in use, or refuses the baud rate.
    """

    def __init__(self, device: str, baud: int, parity: str = serial.PARITY_NONE, stop_bits: int = serial.STOPBITS_ONE) -> None:
        self.device = device
        exclusive = True if os.name == "posix" else None
        try:
            self._port = serial.Serial(device, baud, 8, parity, stop_bits, timeout=0, write_timeout=0, exclusive=exclusive)
        except (OSError, ValueError) as error:
            raise BusUnavailableError(f"serial port {device} at {baud} baud: {why_not_opened(error)}") from error
        if hasattr(self._port, "set_low_latency_mode"):
            # A USB adapter collects bytes for 16 ms by default: four ticks at 256 Hz. Pseudo terminals know no such mode.
            with contextlib.suppress(ValueError, OSError):
                self._port.set_low_latency_mode(True)
        self._port.reset_input_buffer()
        self._descriptor = self._port.fileno() if os.name == "posix" else -1
        if self._descriptor >= 0:
            _tell_silence_from_hang_up(self._descriptor)

    def read(self) -> bytes:
        """Return all bytes that have arrived, or none.

        Raises
        ------
        BusUnavailableError
            The port is gone, e.g. an unplugged adapter.
        """
        try:
            if self._descriptor < 0:
                return bytes(self._port.read(self._port.in_waiting))
            if self._is_silent():
                return b""
            data = os.read(self._descriptor, READ_BYTES)  # pyserial's read takes three system calls
        except BlockingIOError:
            return b""
        except OSError as error:
            raise BusUnavailableError(f"serial port {self.device} is gone: {error.strerror or error}") from error
        if not data:
            raise BusUnavailableError(f"serial port {self.device} is gone: the other end hung up")
        return data

    def _is_silent(self) -> bool:
        """Return whether no bytes have arrived; checked only in a process of real-time priority.

        On Linux a read of an empty line waits until a kernel worker of ordinary priority has passed on what came. For an ordinary process
        that takes no time; one of real-time priority would wait for milliseconds on a loaded computer and miss its tick.
        """
        if not hasattr(os, "sched_getscheduler") or os.sched_getscheduler(0) == os.SCHED_OTHER:
            return False
        return not any(fcntl.ioctl(self._descriptor, termios.FIONREAD, bytes(4)))

    def write(self, data: bytes) -> None:
        """Send without waiting.

        Raises
        ------
        BusUnavailableError
            The port is gone.
        """
        try:
            self._port.write(data)
        except serial.SerialTimeoutException:
            return
        except OSError as error:
            raise BusUnavailableError(f"serial port {self.device} is gone: {error.strerror or error}") from error

    def close(self) -> None:
        """Release the port."""
        self._port.close()


def _tell_silence_from_hang_up(descriptor: int) -> None:
    """Make silence distinguishable from a hang-up: by default an empty read returns no bytes in both cases."""
    attributes = termios.tcgetattr(descriptor)
    attributes[6][termios.VMIN] = 1
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
