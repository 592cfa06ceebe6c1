"""The supervisor in a process of its own, as the loop's process starts and hears it."""

from __future__ import annotations

import multiprocessing
import os
import socket
import time
from multiprocessing.process import BaseProcess
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import can
import numpy as np

from drivers.bus_url import parse_bus_url
from drivers.errors import BusUnavailableError
from drivers.settings import BusSettings
from drivers.shared_memory.block import Block
from drivers.shared_memory.supervisor_blocks import ASKED, END, ORDERS, OWN, PERMITS, ROUNDS, SESSION, TICK_S, WANTED_SESSION, blocks_of
from drivers.supervisor.process import supervise
from drivers.supervisor_link.in_process import took_back
from drivers.supervisor_link.tapped_bus import TappedBus

START_TIMEOUT_S = 60.0  # a new Python process on a loaded machine; one that fails is noticed at once
SILENT_S = 0.25
"""Time without a round of the supervisor after which the loop stops, where no output watchdog says another: sixty rounds at 256 Hz."""
WATCHDOG_SHARE = 0.5
"""Share of the output watchdog's time that it is otherwise: the loop stops before the brakes fall."""
MOST_PERIODS = 2.0
"""Periods between two looks that count as its silence: a loop that was halted for longer was not there to hear, and maybe both were."""
SHARED_BY_PROCESSES = ("socketcan", "udp_multicast")
"""Interfaces that several processes may open at once. Any other has one owner, which passes on its frames."""


class SupervisorProcess:
    """A supervisor beside the loop.

    Parameters
    ----------
    settings : BusSettings
    bus_url : str
    priority : int
        Of the real-time scheduler, where the system grants it; 0 for none.
    stop_socket : Path, optional
        Unix socket at which others on this host may ask for a stop.
    """

    def __init__(self, settings: BusSettings, bus_url: str, priority: int = 0, stop_socket: Path | None = None) -> None:
        self._memory = SharedMemory(create=True, size=Block.bytes(OWN) + Block.bytes(ORDERS))
        self._own, self._orders = blocks_of(self._memory)
        self._told = np.zeros(ORDERS)
        self._seen = np.zeros(OWN)
        self._rounds, self._silent_s, self._looked_at_s = -1.0, 0.0, time.monotonic()
        watchdog = None if settings.io is None else settings.io.watchdog
        self._silent_most_s = SILENT_S if watchdog is None else WATCHDOG_SHARE * watchdog.timeout_s
        self._settings, self._url, self._priority, self._stop_socket = settings, bus_url, priority, stop_socket
        self._tap: socket.socket | None = None
        self._tapped: TappedBus | None = None
        self._session = 0.0
        self._closed = False
        self._process: BaseProcess | None = None

    @property
    def memory_name(self) -> str:
        """Name of the shared memory in which it answers."""
        return self._memory.name

    def tapped(self, bus: can.BusABC) -> can.BusABC:
        """Return the bus, passing on its frames where no other process can open it."""
        if parse_bus_url(self._url).interface in SHARED_BY_PROCESSES:
            return bus
        if not hasattr(socket, "AF_UNIX"):
            raise BusUnavailableError(
                f"{self._url}: its frames cannot be passed on to the supervisor on this system; use socketcan: or udp:"
            )
        self._tap, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        theirs.setblocking(False)
        self._tapped = TappedBus(bus, theirs)
        return self._tapped

    def start(self, io_memory: str = "") -> None:
        """Start it, and wait for its first round.

        Parameters
        ----------
        io_memory : str, optional
            Name of the poller's shared memory.

        Raises
        ------
        BusUnavailableError
            It cannot open the bus, or does not start; `close` is still the caller's to call.
        """
        context = multiprocessing.get_context("spawn")
        arguments = (self._settings, self._url, self._memory.name, io_memory, os.getpid(), self._priority, self._stop_socket, self._tap)
        self._process = context.Process(target=supervise, args=arguments, name="isocenter-supervisor", daemon=True)
        self._process.start()
        give_up = time.monotonic() + START_TIMEOUT_S
        while self._own.sequence < 2:
            if not self._process.is_alive():
                raise BusUnavailableError(f"{self._url}: the supervisor ended at its start with status {self._process.exitcode}")
            if time.monotonic() > give_up:
                raise BusUnavailableError(f"{self._url}: the supervisor did not start within {START_TIMEOUT_S:g} s")
            time.sleep(0.01)
        if (text := self._own.text) and not self._own_rounds():
            raise BusUnavailableError(text)

    def _own_rounds(self) -> float:
        self._own.read(self._seen)
        return float(self._seen[ROUNDS])

    def begin(self) -> None:
        """Begin a session: it permits again."""
        self._session += 1.0
        self._told[WANTED_SESSION] = self._session
        self._orders.write(self._told)
        self._silent_s = 0.0

    def end(self) -> None:
        """End the session: nothing is permitted before the next."""
        self._told[WANTED_SESSION] = -self._session
        self._orders.write(self._told)

    def ticks_begin(self) -> None:
        """Tell when the loop's ticks begin, which is now: between them there is time for the supervisor's rounds."""
        self._told[TICK_S] = time.monotonic()
        self._orders.write(self._told)

    def trouble(self) -> str:
        """Return why nothing may move, in words: its own reason, or that it does not answer; '' where it may move."""
        seen, before_s, self._looked_at_s = self._seen, self._looked_at_s, time.monotonic()
        self._silent_s += min(self._looked_at_s - before_s, MOST_PERIODS * self._settings.sync_period_s)
        if self._own.read(seen) >= 0 and seen[ROUNDS] != self._rounds and seen[SESSION] == self._told[WANTED_SESSION]:
            self._rounds, self._silent_s = seen[ROUNDS], 0.0
        if self._silent_s > self._silent_most_s:
            return f"the supervisor does not answer for {self._silent_s:.2f} s"
        if seen[SESSION] != self._told[WANTED_SESSION]:
            return ""  # it has yet to hear of this session
        if seen[PERMITS] or not (text := self._own.text):
            return ""  # hold-to-run and door, which end the permission without a text, are the loop's to see
        return f"asked to stop by {text}" if seen[ASKED] else took_back(text)

    def close(self) -> None:
        """End it. Never raises; any number of times."""
        if self._closed:
            return
        self._closed = True
        self._told[END] = 1.0
        self._orders.write(self._told)
        if self._process is not None:
            self._process.join(1.0)
            self._process.kill()
            self._process.join()
        if self._tap is not None:
            self._tap.close()
        if self._tapped is not None:
            self._tapped.shutdown()
        self._own.release()
        self._orders.release()
        self._memory.close()
        self._memory.unlink()
