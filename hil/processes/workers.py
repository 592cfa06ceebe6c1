"""Processes that work for another one: they end with it, however it ends."""

from __future__ import annotations

import multiprocessing
import os
import threading
from multiprocessing.process import BaseProcess


def end_with_the_parent() -> None:
    """Ends this process with the one that started it: the initializer of a pool. One that was killed says nothing more to its workers, and
    nobody else ends them.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
