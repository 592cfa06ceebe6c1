"""An operator who looks after an axis that only its drive holds: what is told, and what releases it."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterator

import pytest

from drivers.errors import KEEP_AWAY
from hil.bench.attendant import CONFIRM, HOLD_ENDED, HOW_TO_LEAVE, STAYS, Operator


@pytest.fixture
def types(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], int]]:
    written, read = os.openpty()
    with io.TextIOWrapper(io.BufferedReader(io.FileIO(read))) as stdin, io.FileIO(written, "w") as keys:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield lambda text: keys.write(text.encode())


def test_asking_once_takes_every_line_that_is_there(types: Callable[[str], int]) -> None:
    operator = Operator()
    assert operator.released() == []
    types(f"{CONFIRM} roll\nno\n {CONFIRM.upper()}  propeller \n{CONFIRM}\n{CONFIRM} roll now\n")
    assert operator.released() == ["roll", "propeller"], "without a name, and with more than it, nothing is"
    types("\n")
    assert operator.released() == []


def test_a_line_counts_once_it_is_ended(types: Callable[[str], int]) -> None:
    operator = Operator()
    types(CONFIRM[:3])
    assert operator.released() == []
    types(f"{CONFIRM[3:]} roll\n")
    assert operator.released() == ["roll"]


def test_a_pipe_releases_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    read, written = os.pipe()
    with io.TextIOWrapper(io.BufferedReader(io.FileIO(read))) as stdin, io.FileIO(written, "w") as pipe:
        monkeypatch.setattr(sys, "stdin", stdin)
        pipe.write(f"{CONFIRM} roll\n".encode())
        assert list(Operator().released()) == []


def test_a_closed_or_missing_input_confirms_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull) as nothing:
        for stdin in (nothing, None, io.StringIO(f"{CONFIRM} roll\n")):
            monkeypatch.setattr(sys, "stdin", stdin)
            operator = Operator()
            assert [operator.released(), operator.released()] == [[], []]


def test_what_a_drive_holds_is_told_with_the_way_to_release_it_and_its_end_too() -> None:
    said: list[str] = []
    operator, words = Operator(said.append), "roll held by its drive: its brake reports open"
    operator.say(words)
    operator.say("roll at rest: brake proven, voltage off")
    assert said == [f"{words}. {HOW_TO_LEAVE}", f"roll at rest: brake proven, voltage off. {HOLD_ENDED}"]


def test_nobody_is_sent_to_an_axis_that_moves() -> None:
    said: list[str] = []
    operator = Operator(said.append)
    operator.say(f"{KEEP_AWAY}: roll not proven at rest: its drive is told to hold it and IT MOVES: it had not come to stand")
    operator.say(f"{KEEP_AWAY}: roll: its drive does not hold it")
    for line in said:
        assert line.startswith("KEEP AWAY, PRESS THE EMERGENCY STOP: ")
        assert "upport" not in line
        assert CONFIRM not in line
    assert STAYS in said[0]
