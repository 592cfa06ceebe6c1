"""The starter: runs commands of `isocenter` for the server, one at a time, at the priority that the terminal has.

It holds each on a lead, and lets go of it when it is asked to, when the server has ended, and when the server is silent: a server that
hangs can judge no browser. From then on the terminal hears what the command says, and what is typed there goes to it: where a brake is not
proven the command serves the hold for as long as nobody releases the axis, and the page may be gone.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import IO, cast

from hil.bench.attendant import TypedLines
from hil.bench.told_state import ROWS, STATE

SERVER_SILENT_S = 2.0
"""Time without a word of the server after which the run is stopped, as long as a browser may be silent."""
LOOK_S = 0.1
RUN, LET_GO, SAY, ALIVE = "run", "let go", "say", "alive"
"""What the server tells: run these arguments, let go, write a line to the command's input, nothing but that it is there."""
SAID, ENDED = "said", "ended"
"""What the server is told: a line (text, whether it is an error), and the exit status."""


class Starter:
    """Serves one server.

    Parameters
    ----------
    line : Connection
        To the server.
    command : sequence of str
        How `isocenter` is called on a lead; the descriptor and the arguments follow.
    """

    def __init__(self, line: Connection, command: tuple[str, ...] = (sys.executable, "-m", "hil.console.led")) -> None:
        self._line, self._command = line, command
        self._telling = threading.Lock()
        self._running: _Led | None = None
        self._typed: TypedLines | None = None  # once the terminal hears what runs

    def serve(self, goes_on: Callable[[], bool]) -> None:
        """Serve until the server has ended or `goes_on` says no; return once nothing runs any more."""
        heard_s = time.monotonic()
        try:
            while goes_on():
                self._pass_on_typed()
                if self._line.poll(LOOK_S):
                    self._heed(*self._line.recv())
                    heard_s = time.monotonic()
                elif self._running is not None and time.monotonic() - heard_s > SERVER_SILENT_S:
                    self._let_go_of(self._running)
        except (EOFError, OSError):
            pass
        finally:
            if self._running is not None:
                self._let_go_of(self._running)
                self._see_it_end(self._running)

    def _let_go_of(self, running: _Led) -> None:
        begins = self._typed is None and running.runs
        if begins:
            typed = TypedLines()
            typed.take()  # what was typed before anybody asked is no answer
            self._typed = typed  # before the command stops, so that nothing that it then says or asks is lost
        running.let_go()
        if begins:
            _print("stopping what runs: it is heard here from now on, and hears what you type")

    def _see_it_end(self, running: _Led) -> None:
        """Serve the operator, at the terminal and in the page, until the command has ended."""
        there = True
        while running.runs:
            self._pass_on_typed()
            try:
                while there and self._line.poll():
                    what, with_it = self._line.recv()
                    if what == SAY:
                        running.say(str(with_it))
            except (EOFError, OSError):
                there = False
            running.join(LOOK_S)

    def _pass_on_typed(self) -> None:
        if self._typed is not None and self._running is not None:
            for text in self._typed.take():
                self._running.say(text)

    def _heed(self, what: str, with_it: object) -> None:
        if what == RUN:
            if self._running is not None:
                self._running.join()  # it has told of its end: the server starts nothing before
            self._typed = None
            self._running = _Led(self._command, cast("list[str]", with_it), self._tell)
        elif self._running is not None and what == LET_GO:
            self._running.let_go()
        elif self._running is not None and what == SAY:
            self._running.say(str(with_it))

    def _tell(self, what: str, *with_it: object) -> None:
        if what == SAID and self._typed is not None and not str(with_it[0]).startswith((STATE, ROWS)):  # which are for programs
            _print(str(with_it[0]))
        with self._telling, contextlib.suppress(OSError, ValueError):  # a server that is gone is told nothing
            self._line.send((what, *with_it))


class _Led:
    """One command on its lead."""

    def __init__(self, command: tuple[str, ...], arguments: list[str], tell: Callable[..., None]) -> None:
        held, self._lead = os.pipe()
        self._keys, terminal = os.openpty()  # an axis is released from a terminal alone
        quiet = termios.tcgetattr(terminal)
        quiet[3] &= ~termios.ECHO
        termios.tcsetattr(terminal, termios.TCSANOW, quiet)
        os.set_blocking(self._keys, False)  # lines that the command does not read are lost: the starter must hear of a stop meanwhile
        self._holds = True
        self._tell = tell
        try:
            self._process = subprocess.Popen(
                [*command, str(held), *arguments],
                stdin=terminal,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                pass_fds=(held,),
                start_new_session=True,  # a Ctrl-C at the terminal ends the starter, which then lets go
                env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "400"},
                text=True,
                errors="replace",
            )
        finally:
            os.close(held)
            os.close(terminal)
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        readers = [
            threading.Thread(target=self._read, args=(stream, is_error), daemon=True)
            for stream, is_error in ((self._process.stdout, False), (self._process.stderr, True))
        ]
        for reader in readers:
            reader.start()
        self._waiter = threading.Thread(target=self._wait, args=(readers,), daemon=True)
        self._waiter.start()

    def let_go(self) -> None:
        """Let the command stop, motors first. Any number of times."""
        if self._holds:
            self._holds = False
            os.close(self._lead)

    def say(self, text: str) -> None:
        """Write a line to the command's standard input."""
        with contextlib.suppress(OSError):
            os.write(self._keys, f"{text}\n".encode())

    @property
    def runs(self) -> bool:
        """Whether the command has yet to end."""
        return self._waiter.is_alive()

    def join(self, seconds: float | None = None) -> None:
        """Wait for the command's end, by default however long its stop takes."""
        self._waiter.join(seconds)
        if not self.runs:
            self.let_go()

    def _read(self, stream: IO[str], is_error: bool) -> None:
        for line in stream:
            if line.strip():
                self._tell(SAID, line.rstrip("\n"), is_error)

    def _wait(self, readers: list[threading.Thread]) -> None:
        status = self._process.wait()
        for reader in readers:
            reader.join(1.0)  # a process that it left behind may keep the stream open
        self._tell(ENDED, status)


def _print(text: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # no terminal is there any more
        print(text, file=sys.stderr, flush=True)
