"""Jobs computed one after the other in a process beside this one: the engine that needs nothing else."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from types import FrameType

from hil.fleet.apart import Child
from hil.fleet.job import Job, Outcome

Engine = Callable[[Iterable[Job], threading.Event], Iterator[Outcome]]
"""Computes jobs and yields what became of each, as they end; once the event is set it yields what has ended already and leaves."""


def one_by_one(jobs: Iterable[Job], cancelled: threading.Event) -> Iterator[Outcome]:
    """Compute jobs in their order."""
    child = Child(cancelled.is_set)
    try:
        for job in jobs:
            if cancelled.is_set():
                return
            outcome = child.run(job)
            if not cancelled.is_set() or not outcome.failure:
                yield outcome
    finally:
        child.end()


@contextlib.contextmanager
def cancelled_by_key() -> Iterator[threading.Event]:
    """Make Ctrl-C set an event for the length of the block, and a second one interrupt at once; only in the main thread."""
    cancelled = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield cancelled
        return
    before = signal.getsignal(signal.SIGINT)

    def cancel(number: int, frame: FrameType | None) -> None:
        if cancelled.is_set():
            raise KeyboardInterrupt
        cancelled.set()

    signal.signal(signal.SIGINT, cancel)
    try:
        yield cancelled
    finally:
        signal.signal(signal.SIGINT, before)
