"""Progress where there is no terminal: whole lines on standard error, and none of a task that ends soon."""

from __future__ import annotations

import contextlib
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


def said_at(now_s: float, counts: dict[float, int], monkeypatch: pytest.MonkeyPatch, total: int | None = 200) -> str:
    """The line that stands there after so many seconds, of a task of which so much was done at these times."""
    pipe, clock = Pipe(1), [0.0]
    monkeypatch.setattr(sys, "stderr", pipe)
    monkeypatch.setattr("hil.terminal.progress.time.monotonic", lambda: clock[0])
    lines = Lines(every_s=0.01)
    follow = follower(lines, lines.add_task("run.mf4", total=total))
    for clock[0], done in counts.items():
        follow(done)
    clock[0] = now_s
    lines.start()
    assert pipe.come.wait(10.0)
    lines.stop()
    assert "\r" not in pipe.getvalue()
    return pipe.getvalue().splitlines()[0]


def test_a_line_says_how_far_a_task_is_and_how_long_it_takes_at_the_pace_at_which_it_was_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute of homing goes before; then ten rows a second: of 200, fifteen seconds are left after 50."""
    assert said_at(65.0, {61.0: 10, 65.0: 50}, monkeypatch) == "... run.mf4: 25 % after 65 s, about 15 s to go"
    assert said_at(67.0, {61.0: 10, 65.0: 50}, monkeypatch) == "... run.mf4: 25 % after 67 s, about 13 s to go"


def test_where_no_work_was_counted_no_number_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    assert said_at(240.0, {}, monkeypatch) == "... run.mf4: 240 s"
    assert said_at(240.0, {100.0: 0}, monkeypatch) == "... run.mf4: 240 s"
    assert said_at(240.0, {100.0: 50}, monkeypatch) == "... run.mf4: 25 % after 240 s", "one count has no pace"
    assert said_at(240.0, {100.0: 10, 120.0: 50}, monkeypatch) == "... run.mf4: 25 % after 240 s", "it stands still since"


def test_compiling_is_said_and_how_many_functions_are_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a caller and the two functions that it calls, one of them through another, those that are not compiled yet are left."""
    numba = pytest.importorskip("numba")
    from numba.core import event

    inner = numba.njit(lambda x: x + 1)
    middle = numba.njit(lambda x: 2 * inner(x))
    outer = numba.njit(lambda x: middle(x) - inner(x))

    def said(*compiled: object) -> tuple[int, int]:
        with contextlib.ExitStack() as stack:
            for function in compiled:
                stack.enter_context(event.trigger_event("numba:compile", {"dispatcher": function, "args": (), "return_type": None}))
            line = said_at(1.0, {}, monkeypatch)
        found = re.search(r", compiling \(once on a computer\): (\d+) functions done, (\d+) left before it goes on$", line)
        assert found, line
        return int(found[1]), int(found[2])

    assert "compiling" not in said_at(1.0, {}, monkeypatch)
    done, left = said(outer)
    inner(1)
    assert left == 3
    assert said(outer, middle) == (done + 2, 1), "the caller had its turn, and one that it calls is compiled"
    middle(1)
    assert said(outer)[1] == 0
    assert "compiling" not in said_at(1.0, {}, monkeypatch)


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
