"""An operator who looks after an axis that only its drive holds, at a terminal or through a pipe."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterator

import pytest

from hil.bench.attendant import CONFIRM, HOLD_ENDED, HOW_TO_LEAVE, Operator


@pytest.fixture
def types(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], int]]:
    read, written = os.pipe()
    with io.TextIOWrapper(io.BufferedReader(io.FileIO(read))) as stdin, io.FileIO(written, "w") as keys:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield lambda text: keys.write(text.encode())


def test_asking_once_takes_every_line_that_is_there(types: Callable[[str], int]) -> None:
    operator = Operator()
    assert not operator.released()
    types(f"{CONFIRM}\nno\n {CONFIRM.upper()} \n{CONFIRM}\n")
    assert operator.released()
    types("\n")
    assert not operator.released()


def test_a_line_counts_once_it_is_ended(types: Callable[[str], int]) -> None:
    operator = Operator()
    types(CONFIRM[:3])
    assert not operator.released()
    types(f"{CONFIRM[3:]}\n")
    assert operator.released()


def test_a_closed_or_missing_input_confirms_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull) as nothing:
        for stdin in (nothing, None, io.StringIO(f"{CONFIRM}\n")):
            monkeypatch.setattr(sys, "stdin", stdin)
            operator = Operator()
            assert [operator.released(), operator.released()] == [False, False]


@pytest.mark.parametrize(
    "words", ["roll held by its drive: its brake reports open", "roll not proven at rest: its drive is told to hold it and IT MOVES"]
)
def test_whatever_a_drive_holds_is_told_with_the_way_to_release_it_and_its_end_too(words: str) -> None:
    said: list[str] = []
    operator = Operator(said.append)
    operator.say(words)
    operator.say("roll at rest: brake proven, voltage off")
    assert said == [f"{words}. {HOW_TO_LEAVE}", f"roll at rest: brake proven, voltage off. {HOLD_ENDED}"]
