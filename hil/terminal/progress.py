"""Progress of whatever takes long, on standard error: a bar on a terminal, elsewhere a line every five seconds."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

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
        task.completed = task.completed if completed is None else completed
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
                print(progress_line(self._tasks[-1], time.monotonic()), file=sys.stderr, flush=True)


def progress_line(task: _Task, now_s: float) -> str:
    """Return how far a task is, for how long it has run, and how long it will go on if it goes on like this."""
    taken_s = now_s - task.began_s
    if not task.total:
        return f"... {task.description}: {taken_s:.0f} s"
    share = min(task.completed / task.total, 1.0)
    left = f", about {taken_s * (1.0 - share) / share:.0f} s to go" if 0.0 < share < 1.0 else ""
    return f"... {task.description}: {100.0 * share:.0f} % after {taken_s:.0f} s{left}"


@contextmanager
def progress(live: bool = True, refresh_Hz: float = 10.0, stays: bool = True) -> Iterator[Bars]:
    """Show progress for the length of the block: a bar where standard error is a terminal, elsewhere a line every five seconds.

    With `stays` False the bar is gone when the block has ended. With `live` False nothing is shown while the block runs: a drawing thread
    beside a sample loop on the wall clock costs it milliseconds.
    """
    if live and not sys.stderr.isatty():
        lines = Lines()
        lines.start()
        try:
            yield lines
        finally:
            lines.stop()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
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
