"""The supervisor's own process: it hears the bus itself, and reaches the I/O through whoever polls it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import time
from collections.abc import Callable
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import can
import numpy as np

from drivers.bus_url import open_bus
from drivers.errors import DriverError
from drivers.modbus.io import IoState
from drivers.modbus.published import published_block, state_values, take_state
from drivers.modbus.shared_block import Block
from drivers.settings import BusSettings
from drivers.supervisor.blocks import ANSWER, ASKED, END, FRAME, ORDERS, OWN, PERMITS, ROUNDS, SESSION, WANTED_SESSION, WORD, blocks_of
from drivers.supervisor.supervisor import NMT, Supervisor

HELD_UP_ROUNDS = 8.0  # of a round's time, after which the process was held up: frames have come together meanwhile
MOST_FRAMES = 64  # taken in a round, those of 9 ticks: who judges with frames unread calls a bus silent, who never does is silent itself
LINGERS_S = 2.0  # for which it goes on judging after the loop's process is gone


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
            line = _Tap(tap) if tap is not None else _Line(stack, url, settings.bitrate_bit_s)
        except DriverError as error:
            own.write(np.zeros(OWN), f"the supervisor cannot open the bus: {error}")
            return
        io = None
        if io_memory:
            shared = SharedMemory(name=io_memory)
            stack.callback(shared.close)
            io = published_block(shared, len(settings.scalings))
            stack.callback(io.release)
        asks = _Asks(stack, stop_socket)
        _Rounds(settings, line, own, orders, io, asks, parent).run()


class _Line:
    """The bus, opened once more in this process."""

    def __init__(self, stack: contextlib.ExitStack, url: str, bitrate: int) -> None:
        self._bus = open_bus(url, bitrate)
        stack.callback(self._bus.shutdown)

    def receive(self, timeout_s: float) -> tuple[int, bytes] | None:
        """Return the next data frame with an 11-bit identifier; None where none comes."""
        message = self._bus.recv(timeout_s)
        if message is None or message.is_extended_id or message.is_error_frame or message.is_remote_frame or message.is_fd:
            return None
        return message.arbitration_id, bytes(message.data)

    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame."""
        self._bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))


class _Tap:
    """Frames that the bus's owner passes on."""

    def __init__(self, tap: socket.socket) -> None:
        self._tap = tap

    def receive(self, timeout_s: float) -> tuple[int, bytes] | None:
        """Return the next data frame; None where none comes."""
        self._tap.settimeout(timeout_s)
        try:
            can_id, length, data = FRAME.unpack(self._tap.recv(FRAME.size))
        except (TimeoutError, BlockingIOError):
            return None
        return can_id, data[:length]

    def send(self, can_id: int, data: bytes) -> None:
        """Hand a frame to the owner, which sends it with its next one."""
        self._tap.settimeout(0.0)
        self._tap.send(FRAME.pack(can_id, len(data), data))


class _Asks:
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


class _Rounds:
    """What the process does, round by round: take frames for half a period, then judge and answer."""

    def __init__(
        self, settings: BusSettings, line: _Line | _Tap, own: Block, orders: Block, io: Block | None, asks: _Asks, parent: int
    ) -> None:
        self._supervisor = Supervisor(settings)
        self._settings, self._line, self._own, self._orders, self._io, self._asks = settings, line, own, orders, io, asks
        self._parent = parent
        self._who = ""  # asked for a stop, in any session
        self._stale_s = settings.io.stale_after_s if settings.io is not None else 0.0
        self._supervisor.end()  # until the bench begins a session
        self._round_s = 0.5 * settings.sync_period_s
        self._told = np.zeros(ORDERS)
        self._values = np.zeros(OWN)
        self._state = IoState(len(settings.scalings))
        self._read = np.zeros(state_values(len(settings.scalings)))

    def run(self) -> None:
        """Go on until told to end, or some time after the loop's process is gone."""
        gone_s = 0.0
        while not self._told[END] and gone_s < LINGERS_S:
            began_s = time.monotonic()
            self._heed()
            all_taken = self._take_frames(began_s + self._round_s)
            if not all_taken or time.monotonic() - began_s > HELD_UP_ROUNDS * self._round_s:
                self._supervisor.held_up()
            now_s = time.monotonic()
            if os.getppid() != self._parent:
                gone_s += now_s - began_s
                self._supervisor.refuse(now_s, "the bench's process is gone")
            self._judge(now_s)

    def _take_frames(self, until_s: float) -> bool:
        try:
            for _ in range(MOST_FRAMES):
                if (frame := self._line.receive(max(0.0, until_s - time.monotonic()))) is not None:
                    self._supervisor.frame(time.monotonic(), *frame)
                elif time.monotonic() >= until_s:
                    return True
        except (can.CanError, OSError) as error:
            self._supervisor.refuse(time.monotonic(), f"the bus cannot be read: {error}")
            time.sleep(self._round_s)
        return False

    def _heed(self) -> None:
        """Take the loop's orders and what others ask for."""
        session = self._told[WANTED_SESSION]
        self._orders.read(self._told)
        if self._told[WANTED_SESSION] != session:
            (self._supervisor.begin if self._told[WANTED_SESSION] > 0.0 else self._supervisor.end)()
        self._who = self._who or self._asks.asked(self._seen)
        if self._who:
            self._asks.asked(self._seen)
            self._supervisor.ask_to_stop(time.monotonic(), self._who)

    def _seen(self) -> str:
        return f"{self._supervisor.torque}\n{self._supervisor.reason}"

    def _judge(self, now_s: float) -> None:
        supervisor, values = self._supervisor, self._values
        if self._io is not None and take_state(self._io, self._read, self._state) >= 0:
            fresh = now_s - self._state.time_s <= self._stale_s
            supervisor.io(now_s, self._state.hold_to_run and fresh, self._state.door_closed and fresh, self._state.brakes_open)
        answer = supervisor.answer(now_s, self._state.word)
        values[ROUNDS] += 1.0
        values[SESSION] = self._told[WANTED_SESSION]
        values[PERMITS], values[ASKED] = answer is not None, bool(supervisor.asked_by) and not supervisor.reason
        values[WORD], values[ANSWER] = self._state.word, answer or 0
        self._own.write(values, supervisor.reason or supervisor.asked_by)
        for command in supervisor.commands(now_s):
            with contextlib.suppress(can.CanError, OSError):
                self._line.send(NMT, bytes(command))
