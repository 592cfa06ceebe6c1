"""A process that computes jobs: `python -m hil.fleet.child` reads a line of JSON for each and writes one.

What a job prints goes to standard error. The process ends with the one that started it, however that ends.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import json
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

FIRST_TO_BE_ENDED = "1000"
"""Where the memory of the computer is full, its kernel ends such a process, and nobody else's."""


def main() -> None:
    """Compute jobs until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the key that cancels the run: its parent ends this process
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_BE_ENDED, encoding="ascii")
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    while True:
        call = json.loads(lines.get())
        answers.write(json.dumps(_answer(call["function"], call["argument"])) + "\n")
        answers.flush()


def _read(lines: queue.SimpleQueue[str]) -> None:
    """Read what is to be done, also while something is being done: the end of the input ends the process at once."""
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)


def _answer(function: str, argument: dict[str, Any]) -> dict[str, Any]:
    try:
        return {"value": function_of(function)(argument)}
    except MemoryError:
        return {"failure": "ran out of memory"}
    except Exception as error:
        return {"failure": f"a fault of isocenter itself: {' '.join(repr(error).split())}"}


@functools.cache
def function_of(name: str) -> Callable[[dict[str, Any]], Any]:
    """Return the function of a name `package.module:function`."""
    module, _, attribute = name.partition(":")
    found: Callable[[dict[str, Any]], Any] = getattr(importlib.import_module(module), attribute)
    return found


if __name__ == "__main__":
    main()
