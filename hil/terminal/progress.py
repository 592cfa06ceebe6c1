"""Progress of whatever takes long, on standard error: a bar on a terminal, elsewhere a line every five seconds."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import CellType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.progress import TaskID

EVERY_S = 5.0
"""Time between two lines where there is no terminal: short enough that nobody thinks it hangs, long enough for a log."""


class Bars(Protocol):
    """What draws progress: bars of `rich`, or `Lines`."""

    @property
    def print(self) -> Callable[..., None]:
        """Prints a line above the bars."""

    def add_task(self, description: str, *, total: float | None) -> TaskID:
        """Add a task; `total` None where nobody knows how much there is to do."""

    def update(
        self, task_id: TaskID, *, total: float | None = None, completed: float | None = None, description: str | None = None
    ) -> None:
        """Say how far a task has come."""


@dataclass
class _Task:
    description: str
    total: float | None
    began_s: float
    completed: float = 0.0
    first: tuple[float, float] | None = None  # when work was counted first, and how much of it
    last: tuple[float, float] = (0.0, 0.0)

    def count(self, completed: float, now_s: float) -> None:
        """Take note that so much is done."""
        self.completed = completed
        if completed > 0.0 and (self.first is None or completed > self.last[1]):
            self.last = now_s, completed
            self.first = self.first or self.last

    def left_s(self, now_s: float) -> float:
        """Return how long the rest takes at the pace at which work was counted; NaN where too little was, or none for too long.

        What comes before the first count, such as compiling or a machine's homing, tells nothing of the pace.
        """
        if self.first is None or not self.total or now_s - self.last[0] > self.last[0] - self.first[0]:
            return math.nan
        (began_s, before), (ended_s, done) = self.first, self.last
        return max(0.0, (self.total - done) * (ended_s - began_s) / (done - before) - (now_s - ended_s))


class Dispatcher(Protocol):
    """A function as numba wraps it."""

    py_func: FunctionType
    overloads: Mapping[object, object]
    """What it was compiled for."""
    targetoptions: Mapping[str, object]


class _Compiled:
    """Follows what numba compiles in this process, once numba is there."""

    def __init__(self) -> None:
        self._running: list[Dispatcher] = []  # each for the sake of the one before
        self._called: dict[int, list[Dispatcher]] = {}  # by identity of the function for whose sake others are compiled: it, and they
        self._ended: set[int] = set()
        self._listens = False

    def say(self) -> str:
        """Return in words that functions are compiled, how many were, and how many are left of those that the call that waits needs.

        What is called later may need others: nobody knows them yet. "" where none is compiled now.
        """
        self.listen()
        running = list(self._running)
        if not running:
            return ""
        called = self._called.get(id(running[0]), running)
        left = sum(1 for each in called if id(each) not in self._ended and not each.overloads)
        return f", compiling (once on a computer): {len(self._ended)} functions done, {left} left before it goes on"

    def listen(self) -> None:
        """Begin to follow, where numba is there: before, nothing is compiled."""
        if self._listens or "numba.core.event" not in sys.modules:
            return
        self._listens = True
        from numba.core import event

        counted = self

        class Listener(event.Listener):
            def on_start(self, occasion: event.Event) -> None:
                function = occasion.data["dispatcher"]
                if not counted._running:
                    counted._called[id(function)] = _with_called(function)
                counted._running.append(function)

            def on_end(self, occasion: event.Event) -> None:
                if counted._running:  # one that began before anybody listened has no beginning
                    counted._running.pop()
                counted._ended.add(id(occasion.data["dispatcher"]))

        event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]


def _with_called(function: Dispatcher) -> list[Dispatcher]:
    """Return a function and all that it calls by name, directly or not, of which each is compiled for itself."""
    found: dict[int, Dispatcher] = {}
    waiting = [function]
    while waiting:
        one = waiting.pop()
        if id(one) in found or one.targetoptions.get("inline") == "always":  # which is part of its caller
            continue
        found[id(one)] = one
        waiting += [each for each in _named_in(one.py_func) if hasattr(each, "py_func") and hasattr(each, "overloads")]
    return list(found.values())


def _named_in(function: FunctionType) -> Iterator[Any]:
    """Yield what the names in a function's code stand for: globals, what it closes over, members of modules, elements of tuples."""
    code = function.__code__
    cells = [cell.cell_contents for cell in function.__closure__ or () if cell != CellType()]
    for found in (*(function.__globals__[name] for name in code.co_names if name in function.__globals__), *cells):
        yield from found if isinstance(found, tuple) else (found,)
        if isinstance(found, ModuleType):
            yield from (getattr(found, name) for name in code.co_names if hasattr(found, name))


_compiled = _Compiled()


class Lines:
    """Progress in lines without carriage returns, for pipes and logs: none in the first five seconds, then one every five."""

    def __init__(self, every_s: float = EVERY_S) -> None:
        self._every_s = every_s
        self._tasks: list[_Task] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._write, daemon=True)

    def print(self, text: str, style: str = "") -> None:
        """Write a line of the caller's; a pipe has no styles."""
        print(text, file=sys.stderr, flush=True)

    def add_task(self, description: str, *, total: float | None) -> TaskID:
        """Add a task, of which the lines tell from now on."""
        self._tasks.append(_Task(description, total, time.monotonic()))
        number: TaskID = len(self._tasks) - 1  # type: ignore[assignment]
        return number

    def update(
        self, task_id: TaskID, *, total: float | None = None, completed: float | None = None, description: str | None = None
    ) -> None:
        """Say how far a task has come."""
        task = self._tasks[task_id]
        task.total = task.total if total is None else total
        if completed is not None:
            task.count(completed, time.monotonic())
        task.description = task.description if description is None else description

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def stop(self) -> None:
        """Write nothing more."""
        self._ended.set()
        self._thread.join()

    def _write(self) -> None:
        while not self._ended.wait(self._every_s):
            if self._tasks:
                print(progress_line(self._tasks[-1], time.monotonic()) + _compiled.say(), file=sys.stderr, flush=True)


def progress_line(task: _Task, now_s: float) -> str:
    """Return for how long a task has run and, where its work is counted, how far it is and how long it will go on at that pace."""
    taken_s = now_s - task.began_s
    if not task.total or not task.completed:
        return f"... {task.description}: {taken_s:.0f} s"
    share, left_s = min(task.completed / task.total, 1.0), task.left_s(now_s)
    left = f", about {left_s:.0f} s to go" if share < 1.0 and math.isfinite(left_s) else ""
    return f"... {task.description}: {100.0 * share:.0f} % after {taken_s:.0f} s{left}"


@contextmanager
def progress(live: bool = True, refresh_Hz: float = 10.0, stays: bool = True) -> Iterator[Bars]:
    """Show progress for the length of the block: a bar where standard error is a terminal, elsewhere a line every five seconds.

    With `stays` False the bar is gone when the block has ended. With `live` False nothing is shown while the block runs: a drawing thread
    beside a sample loop on the wall clock costs it milliseconds.
    """
    _compiled.listen()
    if live and not sys.stderr.isatty():
        lines = Lines()
        lines.start()
        try:
            yield lines
        finally:
            lines.stop()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.text import Text

    class Counted(ProgressColumn):
        """How far a task is, where its work is counted, and what is compiled meanwhile."""

        def render(self, task: Task) -> Text:
            share = f"{task.percentage:>3.0f} %" if task.total and task.completed else ""
            return Text(share + _compiled.say())

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        Counted(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not live,
        refresh_per_second=refresh_Hz,
        transient=not stays,
    ) as bars:
        yield bars


@contextmanager
def working(what: str) -> Iterator[None]:
    """Show for the length of the block that something is being worked on, where nobody knows how much is left of it."""
    with progress(stays=False) as bars:
        bars.add_task(what, total=None)
        yield


def follower(bars: Bars, task: TaskID, done: int = 0) -> Callable[[int], None]:
    """Return a callback that moves a bar to `done` plus its argument."""

    def follow(row: int) -> None:
        bars.update(task, completed=done + row)

    return follow
