"""Real-time conditions of a sample loop: a real-time scheduler, locked memory, no garbage collection."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass

FIFO_PRIORITY = 50
"""Middle of the range, the priority of ordinary interrupt threads: the loop need not be above or below them."""

BEHIND_THE_LOOP = 25
"""Of what the loop's estimate waits for: after the loop, its lines and its watchers, before all that is not real-time."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2


@dataclass(frozen=True)
class Scheduling:
    """The granted conditions, reported with every lateness figure."""

    scheduler: str
    memory_locked: bool

    def __str__(self) -> str:
        """Return the conditions in words."""
        return f"{self.scheduler}, memory locked" if self.memory_locked else self.scheduler


@contextlib.contextmanager
def real_time(wanted: bool = True) -> Iterator[Scheduling]:
    """Request SCHED_FIFO and locked memory and freeze the garbage collector, for the length of the block.

    Requests that the system refuses have no effect: without permission the default scheduler stays, and the result says so.
    """
    scheduler, locked = "default scheduler", False
    if wanted and sys.platform == "linux":
        with contextlib.suppress(PermissionError, OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))
            scheduler = f"SCHED_FIFO {FIFO_PRIORITY}"
        with contextlib.suppress(OSError, AttributeError):
            locked = ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_FUTURE) == 0
    gc.collect()
    gc.freeze()
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield Scheduling(scheduler, locked)
    finally:
        if collecting:
            gc.enable()
        gc.unfreeze()
        if scheduler != "default scheduler":
            with contextlib.suppress(PermissionError, OSError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        if locked:
            with contextlib.suppress(OSError, AttributeError):
                ctypes.CDLL(None).munlockall()


def behind_the_loop() -> None:
    """Request SCHED_FIFO after the loop's for this thread, and freeze what is there by now, through which every collection would go.

    Where the system refuses the loop's priority, which the loop then has not either, the scheduler stays as it is. A thread under
    SCHED_FIFO that the loop's interrupts goes on at once on a processor that is free, or has less urgent work; one under the default
    scheduler waits until the next balancing of loads.
    """
    with contextlib.suppress(AttributeError, PermissionError, OSError):
        for priority in (FIFO_PRIORITY, BEHIND_THE_LOOP):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    gc.collect()
    gc.freeze()
