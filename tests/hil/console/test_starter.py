"""What the starter runs is let go when it is asked to, and when the server is gone or silent."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import os
import queue
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

import pytest

from hil.console import starter
from hil.console.starter import Starter

LED = """
import os, signal, sys, threading
from hil.console.led import stop_when_let_go
threading.Thread(target=stop_when_let_go, args=(int(sys.argv[1]),), daemon=True).start()
try:
    print("runs", *sys.argv[2:], flush=True)
    print(sys.stdin.readline().strip(), flush=True)
    sys.exit(7)
except KeyboardInterrupt:
    print("motors stopped", file=sys.stderr, flush=True)
    sys.exit(1)
"""
HOLDS = LED.replace('"motors stopped", file', '"held", file').replace(
    "    sys.exit(1)",
    """
    while (heard := sys.stdin.readline().strip()) != "release":
        print("heard", heard, file=sys.stderr, flush=True)
    print("released", file=sys.stderr, flush=True)
    sys.exit(1)""",
)
"""Holds an axis once it is let go, until somebody releases it."""
DEAF = LED.replace("print(sys.stdin.readline().strip(), flush=True)", "threading.Event().wait()")
WITHIN_S = 20.0


@pytest.fixture
def line() -> Iterator[Connection]:
    ours, theirs = multiprocessing.Pipe()
    goes_on = threading.Event()
    serving = threading.Thread(target=Starter(ours, (sys.executable, "-c", LED)).serve, args=(lambda: not goes_on.is_set(),))
    serving.start()
    yield theirs
    goes_on.set()
    serving.join(WITHIN_S)
    assert not serving.is_alive()


def told(line: Connection) -> tuple[object, ...]:
    assert line.poll(WITHIN_S)
    message: tuple[object, ...] = line.recv()
    return message


def test_a_command_is_heard_and_its_status_told(line: Connection) -> None:
    line.send((starter.RUN, ["home", "-m", "carm"]))
    assert told(line) == (starter.SAID, "runs home -m carm", False)
    line.send((starter.SAY, "release"))
    assert told(line) == (starter.SAID, "release", False)
    assert told(line) == (starter.ENDED, 7)


def test_it_is_let_go_when_asked(line: Connection) -> None:
    line.send((starter.RUN, []))
    told(line)
    line.send((starter.LET_GO, None))
    line.send((starter.LET_GO, None))  # twice does no harm
    assert told(line) == (starter.SAID, "motors stopped", True)
    assert told(line) == (starter.ENDED, 1)


def test_a_command_that_reads_nothing_is_let_go_whatever_was_written_to_it() -> None:
    ours, theirs = multiprocessing.Pipe()
    serving = threading.Thread(target=Starter(ours, (sys.executable, "-c", DEAF)).serve, args=(lambda: True,), daemon=True)
    serving.start()
    theirs.send((starter.RUN, []))
    assert told(theirs) == (starter.SAID, "runs", False)
    for _ in range(100):
        theirs.send((starter.SAY, 2000 * "x"))
    theirs.send((starter.LET_GO, None))
    assert told(theirs) == (starter.SAID, "motors stopped", True)
    theirs.close()
    serving.join(WITHIN_S)
    assert not serving.is_alive()


def test_it_is_let_go_when_the_server_says_nothing_any_more(line: Connection) -> None:
    line.send((starter.RUN, []))
    told(line)
    began_s = time.monotonic()
    assert told(line) == (starter.SAID, "motors stopped", True)
    assert time.monotonic() - began_s < starter.SERVER_SILENT_S + 1.0


def test_a_server_that_is_there_keeps_it_running(line: Connection) -> None:
    line.send((starter.RUN, []))
    told(line)
    until_s = time.monotonic() + 1.25 * starter.SERVER_SILENT_S
    while time.monotonic() < until_s:
        line.send((starter.ALIVE, None))
        assert not line.poll(0.2)


def test_it_is_let_go_when_the_server_is_gone() -> None:
    ours, theirs = multiprocessing.Pipe()
    made = Starter(ours, (sys.executable, "-c", LED))
    serving = threading.Thread(target=made.serve, args=(lambda: True,))
    serving.start()
    theirs.send((starter.RUN, []))
    told(theirs)
    theirs.close()
    serving.join(WITHIN_S)  # it returns only once nothing runs any more
    assert not serving.is_alive()


class Terminal:
    """What a terminal shows and what is typed there."""

    def __init__(self) -> None:
        self.shown: queue.Queue[str] = queue.Queue()
        self._keys, typed = os.openpty()
        self.stdin = io.FileIO(typed)

    def write(self, text: str) -> None:
        self.shown.put(text)

    def flush(self) -> None:
        pass

    def types(self, text: str) -> None:
        os.write(self._keys, f"{text}\n".encode())

    def shows(self, wanted: str) -> None:
        while self.shown.get(timeout=WITHIN_S) != wanted:
            pass

    def close(self) -> None:
        os.close(self._keys)
        self.stdin.close()


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    with contextlib.closing(Terminal()) as terminal:
        yield terminal


class Holding:
    """A starter at a terminal that runs what will hold an axis, its page, and its Ctrl-C."""

    def __init__(self, terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sys, "stdin", terminal.stdin)
        monkeypatch.setattr(sys, "stderr", terminal)
        ours, self.page = multiprocessing.Pipe()
        self.ctrl_c = threading.Event()
        made = Starter(ours, (sys.executable, "-c", HOLDS))
        self._serving = threading.Thread(target=made.serve, args=(lambda: not self.ctrl_c.is_set(),), daemon=True)
        self._serving.start()
        self.page.send((starter.RUN, []))
        told(self.page)

    def ended(self) -> bool:
        self._serving.join(WITHIN_S)
        return not self._serving.is_alive()


def test_after_ctrl_c_the_page_still_releases_what_is_held_and_the_terminal_hears_of_it(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    holding = Holding(terminal, monkeypatch)
    holding.ctrl_c.set()
    assert told(holding.page) == (starter.SAID, "held", True)
    terminal.shows("held")
    holding.page.send((starter.ALIVE, None))
    holding.page.send((starter.RUN, ["another"]))  # begins no more
    holding.page.send((starter.SAY, "release"))
    assert told(holding.page) == (starter.SAID, "released", True)
    assert told(holding.page) == (starter.ENDED, 1)
    assert holding.ended()


@pytest.mark.parametrize("how", ["Ctrl-C", "the server is gone", "the server is silent"])
def test_what_is_held_is_released_at_the_terminal(terminal: Terminal, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    holding = Holding(terminal, monkeypatch)
    terminal.types("release")  # before anybody has asked
    if how == "Ctrl-C":
        holding.ctrl_c.set()
    elif how == "the server is gone":
        holding.page.close()
    terminal.shows("held")
    terminal.types("is it safe?")
    terminal.shows("heard is it safe?")
    terminal.types("release")
    terminal.shows("released")
    holding.ctrl_c.set()
    assert holding.ended()
