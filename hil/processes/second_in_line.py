"""Processes beside the loop's and the emulated machine's: they come second, and end with who started them."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

from hil.processes.workers import end_with_the_parent

POLITE = 10
"""Their niceness: the loop comes first."""


def politely(serve: Callable[..., None], *arguments: object) -> None:
    """What such a process does: `serve(*arguments)`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # what stops the run at the keyboard: the bench ends this process
    end_with_the_parent()
    if hasattr(os, "nice"):
        os.nice(POLITE)
    serve(*arguments)
