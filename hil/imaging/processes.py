"""Processes beside the loop's and the emulated machine's: they come second, and end with who started them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable

POLITE = 10
"""Their niceness: the loop comes first."""


def politely(serve: Callable[..., None], *arguments: object) -> None:
    """What such a process does: `serve(*arguments)`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what stops the run at the keyboard: the bench ends this process
    threading.Thread(target=_end_with_the_bench, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(POLITE)
    serve(*arguments)


def _end_with_the_bench() -> None:
    """A bench that was killed says nothing more, and nobody else ends this process."""
    bench = multiprocessing.parent_process()
    if bench is not None:
        bench.join()
        os._exit(1)
