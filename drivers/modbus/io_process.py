"""Polls the I/O device from a process of its own, because a Modbus client waits and the loop must not.

State and brake commands pass through shared memory. Each side writes its own block only, between two increments of the block's sequence
number, so that the reader can tell a block that was changed under its eyes. When the loop's process dies, the brakes are closed.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Mapping
from multiprocessing.connection import wait
from multiprocessing.shared_memory import SharedMemory

import numpy as np

import drivers.errors
from drivers.errors import BusTimeout, DriverError
from drivers.interface import Sample
from drivers.modbus.io import IoDriver, IoState
from drivers.modbus.transport import ClientTransport, parse_io_url
from drivers.settings import IoMap

SLICE_S = 0.01  # how soon a brake command or the loop's death is noticed
START_TIMEOUT_S = 10.0  # a new Python process on a loaded machine
CLOSE_TIMEOUT_S = 2.0
CLOSE_ATTEMPTS = 5  # of closing the brakes on the way out
ERROR_BYTES = 512
READ_ATTEMPTS = 100


class _Block:
    """Some float64 values and a line of text in shared memory, with one writer and any number of readers."""

    def __init__(self, memory: memoryview, values: int) -> None:
        self._sequence = np.frombuffer(memory, np.int64, 1)
        self._values = np.frombuffer(memory, np.float64, values, 8)
        self._text = np.frombuffer(memory, np.uint8, ERROR_BYTES, 8 + 8 * values)

    @staticmethod
    def bytes(values: int) -> int:
        """Size in memory."""
        return 8 + 8 * values + ERROR_BYTES

    @property
    def sequence(self) -> int:
        """Even: nobody writes. It grows with every write."""
        return int(self._sequence[0])

    def write(self, values: np.ndarray, text: str = "") -> None:
        """Replace the content."""
        self._sequence[0] += 1
        self._values[:] = values
        encoded = text.encode()[:ERROR_BYTES]
        self._text[: len(encoded)] = np.frombuffer(encoded, np.uint8)
        self._text[len(encoded) :] = 0
        self._sequence[0] += 1

    def read(self, into: np.ndarray) -> int:
        """Copy the values; return the sequence number they belong to, or -1 when the writer was always in the way."""
        for _ in range(READ_ATTEMPTS):
            before = self.sequence
            into[:] = self._values
            if before == self.sequence and before % 2 == 0:
                return before
        return -1

    @property
    def text(self) -> str:
        """The line of text."""
        for _ in range(READ_ATTEMPTS):
            before = self.sequence
            encoded = self._text.tobytes()
            if before == self.sequence and before % 2 == 0:
                return encoded.rstrip(b"\0").decode(errors="replace")
        return ""

    def release(self) -> None:
        """Let go of the memory, so that it can be closed."""
        del self._sequence, self._values, self._text


def _state_values(axes: int) -> int:
    return 3 + 2 * axes  # time, hold-to-run, door, temperatures, brakes


class IoProcess:
    """The I/O device behind a process of its own, with the face of `drivers.modbus.io.Io`.

    Parameters
    ----------
    io_map : IoMap
        Where everything lives; its `url` says how to reach the device.
    axes : tuple of str
        Order of the axes in arrays.
    """

    def __init__(self, io_map: IoMap, axes: tuple[str, ...]) -> None:
        parse_io_url(io_map.url)
        self._map = io_map
        self._axes = axes
        self._brakes = np.zeros(len(axes))
        self._values = np.zeros(_state_values(len(axes)))
        self._state = IoState(len(axes))
        self._seen = 0
        self._closed = False
        self._memory = SharedMemory(create=True, size=_Block.bytes(len(self._values)) + _Block.bytes(len(axes) + 1))
        self._published, self._command = _blocks(self._memory, len(axes))
        # A fresh interpreter: a forked one would inherit the loop's memory, locked and all, and what its threads hold.
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(
            target=_poll_until_told, args=(io_map, axes, self._memory.name, os.getpid()), name="isocenter-io", daemon=True
        )

    def start(self) -> None:
        """Start polling and wait for the first answer.

        Raises
        ------
        BusUnavailable, BusTimeout, ConfigurationRefused, ProtocolError
            The first poll failed; the process is gone then.
        """
        self._process.start()
        give_up = time.monotonic() + START_TIMEOUT_S
        while self._published.sequence < 2:
            if time.monotonic() > give_up or not self._process.is_alive():
                self.close()
                raise BusTimeout(f"io on {self._map.url}: the polling process did not start within {START_TIMEOUT_S:g} s")
            time.sleep(SLICE_S)
        if failure := self.error:
            self.close()
            kind, _, text = failure.partition(": ")
            raise getattr(drivers.errors, kind, DriverError)(text)

    @property
    def error(self) -> str:
        """Why the newest poll failed, as `ExceptionClass: message`; empty when it did not."""
        return self._published.text

    def poll_due(self, now_s: float) -> None:
        """Nothing to do: the other process polls by itself."""

    def update(self, sample: Sample) -> None:
        """Copy the newest state into the sample."""
        if self._published.sequence != self._seen:
            self._take_over()
        self._state.copy_to(sample, time.monotonic(), self._map.stale_after_s)

    def command_brakes(self, brakes: Mapping[str, bool]) -> None:
        """Open (True) or close the brakes of the named axes; noticed by the other process within a hundredth of a second."""
        for index, axis in enumerate(self._axes):
            if axis in brakes:
                self._brakes[index] = brakes[axis]
        self._command.write(np.append(self._brakes, 0.0))

    def close(self) -> None:
        """Close the brakes and end the process."""
        if self._closed:
            return
        self._closed = True
        self._command.write(np.append(np.zeros(len(self._axes)), 1.0))
        if self._process.pid is not None:
            self._process.join(CLOSE_TIMEOUT_S)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
        self._published.release()
        self._command.release()
        self._memory.close()
        self._memory.unlink()

    def _take_over(self) -> None:
        sequence = self._published.read(self._values)
        if sequence < 0:
            return
        self._seen = sequence
        state, values, axes = self._state, self._values, len(self._axes)
        state.time_s = float(values[0])
        state.hold_to_run = bool(values[1])
        state.door_closed = bool(values[2])
        state.temperature_degC[:] = values[3 : 3 + axes]
        state.brakes_open[:] = values[3 + axes :]


def _blocks(memory: SharedMemory, axes: int) -> tuple[_Block, _Block]:
    """The state, written by the polling process, and the command, written by the loop's."""
    values = _state_values(axes)
    split = _Block.bytes(values)
    buffer = memory.buf
    assert buffer is not None, "shared memory was closed"
    return _Block(buffer[:split], values), _Block(buffer[split:], axes + 1)


def _poll_until_told(io_map: IoMap, axes: tuple[str, ...], memory_name: str, parent: int) -> None:
    """The polling process: until it is told to end, asked to by a signal, or left alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the loop decides what it means
    signal.signal(signal.SIGTERM, lambda *_: _raise_exit())
    _leave_real_time()
    memory = SharedMemory(name=memory_name)
    published, command = _blocks(memory, len(axes))
    driver = IoDriver(io_map, ClientTransport(io_map.url), axes)
    try:
        _Poller(io_map, axes, driver, published, command, parent).run()
    finally:
        for _ in range(CLOSE_ATTEMPTS):
            driver.command_brakes(dict.fromkeys(axes, False))
            with contextlib.suppress(DriverError):
                driver.poll_once(time.monotonic())
                break
        published.release()
        command.release()
        memory.close()


def _raise_exit() -> None:
    raise SystemExit


def _leave_real_time() -> None:
    """A child inherits the loop's scheduler, and must not compete with it."""
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class _Poller:
    """Polls, publishes, obeys."""

    def __init__(
        self, io_map: IoMap, axes: tuple[str, ...], driver: IoDriver, published: _Block, command: _Block, parent: int
    ) -> None:
        self._map = io_map
        self._axes = axes
        self._driver = driver
        self._published = published
        self._command = command
        self._parent = parent
        self._obeyed = 0
        self._wanted = np.zeros(len(axes) + 1)

    def run(self) -> None:
        """Until told to end, or the loop's process is gone."""
        while not self._wanted[-1] and not self._orphaned():
            self._obey()
            self._poll()
            self._rest()

    def _poll(self) -> None:
        state = self._driver.state
        failure = ""
        try:
            self._driver.poll_once(time.monotonic())
        except DriverError as error:
            failure = f"{type(error).__name__}: {error}"
            if time.monotonic() - state.time_s > self._map.stale_after_s:
                # After a long silence nobody knows what the machine did: brakes stay closed until they are commanded anew.
                self._driver.command_brakes(dict.fromkeys(self._axes, False))
        values = np.concatenate(((state.time_s, state.hold_to_run, state.door_closed), state.temperature_degC, state.brakes_open))
        self._published.write(values, failure)

    def _obey(self) -> None:
        if self._command.sequence == self._obeyed:
            return
        sequence = self._command.read(self._wanted)
        if sequence >= 0:
            self._obeyed = sequence
            self._driver.command_brakes({axis: bool(is_open) for axis, is_open in zip(self._axes, self._wanted, strict=False)})

    def _rest(self) -> None:
        """Until the next poll is due, a command waits, or the loop's process is gone."""
        until = time.monotonic() + self._map.poll_period_s
        while (left := until - time.monotonic()) > 0.0:
            if self._command.sequence != self._obeyed or self._orphaned(min(left, SLICE_S)):
                return

    def _orphaned(self, timeout_s: float = 0.0) -> bool:
        """Whether the loop's process is gone; waits for that at most so long.

        The sentinel tells at once but can be held open by another child of the loop's process; the parent's number tells where it exists.
        """
        loop = multiprocessing.parent_process()
        gone = loop is not None and bool(wait([loop.sentinel], timeout_s))
        return gone or (os.name == "posix" and os.getppid() != self._parent)
