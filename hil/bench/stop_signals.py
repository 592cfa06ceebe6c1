"""Signals that end a run, motors stopped."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

from hil.bench.signals import StopRequest
from hil.errors import LoopAbortedError


@contextlib.contextmanager
def stopping_on_signals(request: StopRequest, stopping: Callable[[], bool]) -> Iterator[None]:
    """Let SIGINT, SIGTERM, SIGHUP and SIGQUIT end the run at the next tick, motors stopped.

    A second signal ends it at once, unless the motors are being stopped already: an interrupted stop may take the voltage from a drive
    before its brake has closed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def ask(number: int, frame: FrameType | None) -> None:
        if request.reason and not stopping():
            raise LoopAbortedError("interrupted twice")
        request.ask(f"asked to stop by {signal.Signals(number).name}")

    asking = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)]  # not all everywhere
    before = {number: signal.signal(number, ask) for number in asking}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
