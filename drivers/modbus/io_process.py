"""Polls the I/O device from a separate process, because a Modbus client waits and the loop must not.

State and brake commands pass through shared memory, and each side writes only its own block. When the loop's process dies or stands still,
the brakes are closed. The polling process has its own session, so that a lost terminal or a quit key, which end the loop, do not end it.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import time
from collections.abc import Mapping
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from multiprocessing.shared_memory import SharedMemory

import numpy as np

import drivers.errors
from drivers.errors import BusTimeoutError, DriverError
from drivers.interface import Sample
from drivers.modbus.io import IoDriver, brake_requests
from drivers.modbus.transport import REQUEST_AT_MOST_S, ClientTransport, parse_io_url
from drivers.settings import IoMap
from drivers.shared_memory.block import Block
from drivers.shared_memory.io_state import IoState, published_block, state_values, take_state, values_of
from drivers.shared_memory.supervisor_blocks import AnswerReader

SLICE_S = 0.01  # how soon a brake command or the loop's death is noticed
START_TIMEOUT_S = 60.0  # a new Python process on a loaded machine; one that fails is noticed at once
LOOP_STILL_S = 0.5
"""Longest pause of the loop with a brake open: over a hundred ticks, more than a busy processor explains. A loop that is stopped, swapped
out or in a debugger does not close its brakes, and without its SYNC and heartbeat the drives hold nothing."""

POLLER_HANGS_S = 4.0 * REQUEST_AT_MOST_S  # without a word of the polling process: a poll is three requests
CLOSE_ATTEMPTS = 5  # of closing the brakes on the way out
CLOSE_PAUSE_S = 0.2  # between attempts: a connection is refused within microseconds, while a device that restarts its server takes longer
EXIT_S = 1.0  # a Python process that ends, on a loaded machine
READ_REQUESTS = 2  # of a poll that may be under way


def _command_values(axes: int) -> int:
    return axes + 2  # brake orders, then:


_TICKS, _END = -2, -1  # number of times that the loop has asked for the state; whether polling shall end


class IoProcess:
    """The I/O device behind a separate process, with the interface of `drivers.modbus.io.Io`.

    Parameters
    ----------
    io_map : IoMap
        Addresses of the inputs and outputs; its `url` says how to reach the device.
    axes : tuple of str
        Order of the axes in arrays.
    refresh_from : str, optional
        Name of the supervisor's shared memory, where the answers to the device's watchdog lie.

    Attributes
    ----------
    trouble : str
        After `close`: why the brakes may still be open; empty when they were closed, or never opened.
    """

    def __init__(self, io_map: IoMap, axes: tuple[str, ...], refresh_from: str = "") -> None:
        parse_io_url(io_map.url)
        self._refresh_from = refresh_from
        self.trouble = ""
        self._map = io_map
        self._axes = axes
        self._orders = 0
        self._opened = False
        self._told = np.zeros(_command_values(len(axes)))  # an axis' brake: number of its newest order, negative when it is to close
        self._values = np.zeros(state_values(len(axes)))
        self._state = IoState(len(axes))
        self._seen = 0
        self._closed = False
        self._memory = SharedMemory(create=True, size=Block.bytes(len(self._values)) + Block.bytes(len(self._told)))
        self._published, self._command = published_block(self._memory, len(axes)), _command_block(self._memory, len(axes))
        self._process = self._new_process()
        self._heard_s = math.inf  # when the polling process last published anything

    def _new_process(self) -> SpawnProcess:
        """Return a polling process in a fresh interpreter: a forked one would inherit the loop's locked memory and its threads' locks."""
        context = multiprocessing.get_context("spawn")
        arguments = (self._map, self._axes, self._memory.name, os.getpid(), self._refresh_from)
        return context.Process(target=_poll_until_told, args=arguments, name="isocenter-io", daemon=True)

    def _replace_dead_process(self) -> None:
        """Start another polling process where the old one is gone or hangs: somebody must close the brakes."""
        hangs = time.monotonic() - self._heard_s > POLLER_HANGS_S
        if self._closed or self._process.pid is None or not (hangs or not self._process.is_alive()):
            return
        self._process.kill()
        self._process.join()
        self._heard_s = math.inf
        self._process = self._new_process()
        self._process.start()

    def start(self) -> None:
        """Start polling and wait for the first answer.

        Raises
        ------
        BusUnavailableError, BusTimeoutError, ConfigurationRefusedError, ProtocolError
            The first poll failed; the process has then ended.
        """
        self._process.start()
        give_up = time.monotonic() + START_TIMEOUT_S
        while self._published.sequence < 2:
            if time.monotonic() > give_up or not self._process.is_alive():
                self.close()
                raise BusTimeoutError(f"io on {self._map.url}: the polling process did not start within {START_TIMEOUT_S:g} s")
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
        """Do nothing: the other process polls by itself."""

    def update(self, sample: Sample) -> None:
        """Copy the newest state into the sample; call it every tick, or the other process closes the brakes (`LOOP_STILL_S`)."""
        self._told[_TICKS] += 1.0
        self._command.write(self._told)
        if self._published.sequence != self._seen:
            self._take_over()
        self._state.copy_to(sample, time.monotonic(), self._map.stale_after_s)

    def command_brakes(self, brakes: Mapping[str, bool]) -> None:
        """Open (True) or close the brakes of the named axes; the other process notices within a hundredth of a second.

        A polling process that is gone or hangs is replaced when brakes are to close.
        """
        if not any(brakes.values()):
            self._replace_dead_process()
        self._orders += 1
        for index, axis in enumerate(self._axes):
            if axis in brakes:
                self._told[index] = self._orders if brakes[axis] else -self._orders
                self._opened = self._opened or brakes[axis]
        self._command.write(self._told)

    def close(self) -> None:
        """Close the brakes, if any was ever opened, and end the process; errors are in `trouble`. Never raises."""
        if self._closed:
            return
        self._closed = True
        self._told[_END] = 1.0
        self._command.write(self._told)
        try:
            if self._process.pid is not None:
                self._end_process()
        finally:
            self._published.release()
            self._command.release()
            self._memory.close()
            self._memory.unlink()

    def _end_process(self) -> None:
        bound_s = close_at_most_s(self._map)
        self._process.join(bound_s)
        late = self._process.is_alive()
        if late:
            self._process.kill()
            self._process.join()
        if not self._opened:
            return
        if late:
            self.trouble = f"io on {self._map.url}: the polling process did not end within {bound_s:.1f} s; brakes may be open"
        elif self._process.exitcode:
            self.trouble = f"io on {self._map.url}: the polling process ended with status {self._process.exitcode}; brakes may be open"
        else:
            self.trouble = self.error

    def _take_over(self) -> None:
        sequence = take_state(self._published, self._values, self._state)
        if sequence >= 0:
            self._seen = sequence
            self._heard_s = time.monotonic()

    @property
    def memory_name(self) -> str:
        """Name of the shared memory that begins with the published state."""
        return self._memory.name


def _command_block(memory: SharedMemory, axes: int) -> Block:
    """Return the block of the command, written by the loop's process; it lies behind the state."""
    buffer = memory.buf
    assert buffer is not None, "shared memory was closed"
    return Block(buffer[Block.bytes(state_values(axes)) :], _command_values(axes))


def close_at_most_s(io_map: IoMap) -> float:
    """Return the longest time [s] of the polling process to close the brakes and end: the current poll and every attempt at its longest."""
    writes = brake_requests(io_map)
    requests = writes + READ_REQUESTS + CLOSE_ATTEMPTS * writes
    return requests * REQUEST_AT_MOST_S + (CLOSE_ATTEMPTS - 1) * CLOSE_PAUSE_S + EXIT_S


def _poll_until_told(io_map: IoMap, axes: tuple[str, ...], memory_name: str, parent: int, refresh_from: str) -> None:
    """Run the polling process until it is told to end, receives a signal, or the loop's process is gone."""
    _leave_session()
    _leave_real_time()
    memory = SharedMemory(name=memory_name)
    published, command = published_block(memory, len(axes)), _command_block(memory, len(axes))
    answers = AnswerReader(refresh_from) if refresh_from else None
    driver = IoDriver(io_map, ClientTransport(io_map.url), axes, answers)
    poller = _Poller(io_map, axes, driver, published, command, parent)
    signal.signal(signal.SIGTERM, poller.ask_to_end)  # sets a flag: an exception, the second at the latest, would break the closing off
    try:
        poller.run()
    finally:
        poller.say(_close_brakes(driver, axes) if poller.opened else "")
        published.release()
        command.release()
        memory.close()
        if answers is not None:
            answers.close()
        if poller.orphaned():
            with contextlib.suppress(OSError):
                memory.unlink()  # nobody else is left to do it


def _close_brakes(driver: IoDriver, axes: tuple[str, ...]) -> str:
    """Try several times to close the brakes; return why it failed, or ''."""
    trouble = ""
    driver.command_brakes(dict.fromkeys(axes, False))
    for attempt in range(CLOSE_ATTEMPTS):
        if attempt:
            time.sleep(CLOSE_PAUSE_S)
        try:
            driver.write_brakes()
            return ""
        except Exception as error:  # the next attempt follows any error
            trouble = f"{error}; the brakes could not be closed in {CLOSE_ATTEMPTS} attempts and may be open"
    return trouble


def _leave_session() -> None:
    """Leave the terminal's session, so that its signals to the foreground do not reach the process that closes the brakes."""
    if hasattr(os, "setsid"):
        with contextlib.suppress(OSError):
            os.setsid()
    for name in ("SIGINT", "SIGHUP", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def _leave_real_time() -> None:
    """Leave the real-time scheduler that a child inherits from the loop, so that it does not compete with it."""
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class _Poller:
    """Polls the device, publishes its state and executes commands."""

    def __init__(self, io_map: IoMap, axes: tuple[str, ...], driver: IoDriver, published: Block, command: Block, parent: int) -> None:
        self.opened = False  # whether it was ever told to open a brake
        self._map = io_map
        self._axes = axes
        self._driver = driver
        self._published = published
        self._command = command
        self._parent = parent
        self._read_sequence = 0
        self._reading = np.zeros(_command_values(len(axes)))
        self._wanted = self._reading.copy()  # the newest command that was read whole
        self._obeyed = self._reading[:_TICKS].copy()
        self._open = np.zeros(len(axes), dtype=bool)  # as told to the driver
        self._ticks = 0.0
        self._ticked_s = time.monotonic()
        self._asked_to_end = False

    def run(self) -> None:
        """Poll until told to end, or the loop's process is gone."""
        while not self._asked_to_end and not self.orphaned():
            self._heed()
            if self._wanted[_END]:
                return
            self._poll()
            self._rest()

    def ask_to_end(self, *_: object) -> None:
        """End after the current poll; a signal handler."""
        self._asked_to_end = True

    def say(self, text: str) -> None:
        """Publish the state with a line of text."""
        self._published.write(values_of(self._driver.state), text)

    def orphaned(self, timeout_s: float = 0.0) -> bool:
        """Return whether the loop's process is gone; wait for that at most this long.

        The sentinel reports it at once but can be held open by another child of the loop's process; the parent's process id, where it
        exists, cannot.
        """
        loop = multiprocessing.parent_process()
        gone = loop is not None and bool(wait([loop.sentinel], timeout_s))
        return gone or (os.name == "posix" and os.getppid() != self._parent)

    def _poll(self) -> None:
        failure = ""
        try:
            self._driver.poll_once(time.monotonic())
        except DriverError as error:
            failure = f"{type(error).__name__}: {error}"
            if time.monotonic() - self._driver.state.time_s > self._map.stale_after_s:
                self._close_until_told()  # after a long silence the machine's state is unknown
        self.say(failure)

    def _heed(self) -> bool:
        """Take over the command of the loop's process; return whether the brakes must be written for it."""
        if self._command.sequence != self._read_sequence:
            sequence = self._command.read(self._reading)
            if sequence >= 0:
                self._read_sequence = sequence
                self._wanted[:] = self._reading
        now_s = time.monotonic()
        if self._wanted[_TICKS] != self._ticks:
            self._ticks = float(self._wanted[_TICKS])
            self._ticked_s = now_s
        if (self._wanted[:_TICKS] != self._obeyed).any():
            self._ticked_s = now_s
            self._obey()
            return True
        return now_s - self._ticked_s > LOOP_STILL_S and self._close_until_told()

    def _obey(self) -> None:
        orders = self._wanted[:_TICKS]
        new = orders != self._obeyed
        self._obeyed[:] = orders
        self._open[new] = orders[new] > 0.0
        self.opened = self.opened or bool(self._open.any())
        self._driver.command_brakes({self._axes[index]: bool(self._open[index]) for index in np.flatnonzero(new)})

    def _close_until_told(self) -> bool:
        """Close the open brakes until they are commanded again; return whether any was open."""
        if not self._open.any():
            return False
        self._open[:] = False
        self._driver.command_brakes(dict.fromkeys(self._axes, False))
        return True

    def _rest(self) -> None:
        """Rest until the next poll is due, brakes must be written, or polling shall end."""
        until = time.monotonic() + self._map.poll_period_s
        while (left := until - time.monotonic()) > 0.0:
            if self._asked_to_end or self._heed() or self._wanted[_END] or self.orphaned(min(left, SLICE_S)):
                return
            with contextlib.suppress(DriverError):  # the next poll tells
                self._driver.refresh()
