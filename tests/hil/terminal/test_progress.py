"""Progress where there is no terminal: whole lines on standard error, and none of a task that ends soon."""

from __future__ import annotations

import io
import re
import sys
import threading

import pytest

from hil.terminal.progress import EVERY_S, Lines, follower, progress, working


class Pipe(io.StringIO):
    """A standard error that is no terminal, and says when so many lines have come."""

    def __init__(self, wanted: int) -> None:
        super().__init__()
        self.come = threading.Event()
        self._wanted = wanted

    def write(self, text: str) -> int:
        written = super().write(text)
        if self.getvalue().count("\n") >= self._wanted:
            self.come.set()
        return written


def test_a_line_says_how_far_a_task_is_and_how_long_it_will_take(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Pipe(2)
    monkeypatch.setattr(sys, "stderr", pipe)
    lines = Lines(every_s=0.01)
    follow = follower(lines, lines.add_task("run.mf4", total=200), done=20)
    follow(30)
    lines.start()
    assert pipe.come.wait(10.0)
    lines.stop()
    said = pipe.getvalue()
    assert "\r" not in said
    assert re.fullmatch(r"(\.\.\. run\.mf4: 25 % after \d+ s, about \d+ s to go\n)+", said)


def test_a_task_of_unknown_length_says_how_long_it_has_run(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Pipe(1)
    monkeypatch.setattr(sys, "stderr", pipe)
    lines = Lines(every_s=0.01)
    lines.add_task("identifying", total=None)
    lines.start()
    assert pipe.come.wait(10.0)
    lines.stop()
    assert re.fullmatch(r"(\.\.\. identifying: \d+ s\n)+", pipe.getvalue())


def test_what_ends_soon_says_nothing_and_a_line_comes_every_five_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Pipe(1)
    monkeypatch.setattr(sys, "stderr", pipe)
    with progress() as bars:
        bars.update(bars.add_task("short", total=1), completed=1)
    with working("short, too"):
        pass
    assert pipe.getvalue() == ""
    assert EVERY_S == 5.0
