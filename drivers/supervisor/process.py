"""The supervisor's own process: it hears the bus itself, and reaches the I/O through whoever polls it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
from collections.abc import Callable
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import can
import numpy as np

from drivers.bus_url import open_bus
from drivers.errors import DriverError
from drivers.settings import BusSettings
from drivers.shared_memory.io_state import published_block
from drivers.shared_memory.supervisor_blocks import FRAME, OWN, blocks_of
from drivers.supervisor.rounds import Line, Rounds, Shared
from drivers.supervisor.supervisor import Supervisor

MOST_OTHERS = 512
"""Frames of other kinds passed over at once: 8 in a millisecond, as many as 1 Mbit/s carries, for 64 ms."""


def supervise(
    settings: BusSettings,
    url: str,
    memory_name: str,
    io_memory: str,
    parent: int,
    priority: int,
    stop_socket: Path | None,
    tap: socket.socket | None,
) -> None:
    """Run the supervisor's process until it is told to end, or some time after the loop's process is gone."""
    for name in ("SIGINT", "SIGHUP", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if priority and hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    memory = SharedMemory(name=memory_name)
    own, orders = blocks_of(memory)
    with contextlib.ExitStack() as stack:
        stack.callback(memory.close)
        stack.callback(orders.release)
        stack.callback(own.release)
        try:
            line: Line = Tap(tap) if tap is not None else BusLine(stack, url, settings.bitrate_bit_s)
        except DriverError as error:
            own.write(np.zeros(OWN), f"the supervisor cannot open the bus: {error}")
            return
        io = None
        if io_memory:
            shared = SharedMemory(name=io_memory)
            stack.callback(shared.close)
            io = published_block(shared, len(settings.scalings))
            stack.callback(io.release)
        asks = StopSocket(stack, stop_socket)
        Rounds(settings, Supervisor(settings), line, Shared(own, orders, io), asks.asked, lambda: os.getppid() == parent).run()


class BusLine:
    """The bus, opened once more in this process."""

    def __init__(self, stack: contextlib.ExitStack, url: str, bitrate: int) -> None:
        self._bus = open_bus(url, bitrate)
        stack.callback(self._bus.shutdown)

    def receive(self) -> tuple[int, bytes] | None:
        """Return the next data frame with an 11-bit identifier that has come, past any other; None where none has."""
        for _ in range(MOST_OTHERS):
            message = self._bus.recv(0.0)
            if message is None:
                break
            if not (message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd):
                return message.arbitration_id, bytes(message.data)
        return None

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame."""
        self._bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))


class Tap:
    """Frames that the bus's owner passes on."""

    def __init__(self, tap: socket.socket) -> None:
        self._tap = tap
        tap.setblocking(False)

    def receive(self) -> tuple[int, bytes] | None:
        """Return the next data frame that has come; None where none has."""
        try:
            can_id, length, data = FRAME.unpack(self._tap.recv(FRAME.size))
        except BlockingIOError:
            return None
        return can_id, data[:length]

    def send(self, can_id: int, data: bytes) -> None:
        """Hand a frame to the owner, which sends it with its next one."""
        self._tap.send(FRAME.pack(can_id, len(data), data))


class StopSocket:
    """The socket at which others on this host ask for a stop; each question is answered with what is seen."""

    def __init__(self, stack: contextlib.ExitStack, path: Path | None) -> None:
        self._socket = None
        if path is not None and hasattr(socket, "AF_UNIX"):
            path.unlink(missing_ok=True)  # left by one that was killed
            line = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            with contextlib.suppress(OSError):  # a path that is too long, a folder that is full: nobody can ask, the rest goes on
                line.bind(str(path))
                line.setblocking(False)
                self._socket = line
                stack.callback(path.unlink, missing_ok=True)

    def asked(self, seen: Callable[[], str]) -> str:
        """Return who asks now, in words; '' where nobody does."""
        if self._socket is None:
            return ""
        try:
            words, sender = self._socket.recvfrom(200)
        except OSError:
            return ""
        with contextlib.suppress(OSError, TypeError):  # one without an address of its own gets no answer
            self._socket.sendto(seen().encode(), sender)
        return words.decode(errors="replace")
