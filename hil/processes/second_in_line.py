"""Processes beside the loop's and the emulated machine's: they have lower priority, and end with their parent."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

from hil.processes.workers import end_with_the_parent

POLITE = 10
"""Niceness of these processes, since the loop comes first."""


PROMPT = 5
"""Niceness of one that the loop's estimate or a STOP waits for: before everything else of ours, but after the loop."""


def politely(serve: Callable[..., None], *arguments: object, niceness: int = POLITE) -> None:
    """Run `serve(*arguments)` as such a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the key that stops the run: the bench ends this process
    end_with_the_parent()
    if hasattr(os, "nice"):
        os.nice(niceness)
    serve(*arguments)
