"""What the starter runs is let go when it is asked to, and when the server is gone or silent."""

from __future__ import annotations

import multiprocessing
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
print("runs", *sys.argv[2:], flush=True)
try:
    print(sys.stdin.readline().strip(), flush=True)
    sys.exit(7)
except KeyboardInterrupt:
    print("motors stopped", file=sys.stderr, flush=True)
    sys.exit(1)
"""
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
