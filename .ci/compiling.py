"""How long numba compiles, over all processes of a run.

`.ci/run` installs this module into the environment of the tests as an extension of numba (entry point `numba_extensions`), so numba calls
`init` in every process that compiles or loads machine code. As a program it says what was compiled:

    python .ci/compiling.py FOLDER PROCESSOR_SECONDS
"""

from __future__ import annotations

import hashlib
import os
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

FOLDER_VARIABLE = "ISOCENTER_COMPILING"


def init() -> None:
    """Write down what this process compiles, where the variable names a folder."""
    folder = os.environ.get(FOLDER_VARIABLE)
    if not folder:
        return
    from numba.core import event

    file = Path(folder) / f"{os.getpid()}-{time.time_ns()}"
    running = threading.local()  # when the functions that are being compiled were begun, by thread

    class Noted(event.Listener):
        def on_start(self, occasion: event.Event) -> None:
            running.since = [*getattr(running, "since", ()), time.thread_time()]

        def on_end(self, occasion: event.Event) -> None:
            *callers, since = running.since
            running.since = callers
            if callers:  # the caller's time has it
                return
            function, data = occasion.data["dispatcher"].py_func, occasion.data
            arguments = hashlib.sha256(str(data["args"]).encode()).hexdigest()[:12]
            with file.open("a") as noted:
                noted.write(f"{time.thread_time() - since:.3f} {function.__module__}:{function.__qualname__}({arguments})\n")

    event.register("numba:compile", Noted())


def told(folder: Path, processor_s: float) -> str:
    """Say how long was compiled, which share of these seconds that is, and what of it a shared cache would have saved."""
    lines = [line.split() for file in sorted(folder.iterdir()) for line in file.read_text().splitlines()]
    total, again, known = 0.0, 0.0, Counter[str]()
    for seconds, name in lines:
        total += float(seconds)
        again += float(seconds) if known[name] else 0.0
        known[name] += 1
    repeated = len(lines) - len(known)
    share = f"{100.0 * total / processor_s:.0f} % of the tests'" if processor_s else "share unknown"
    return f"compiling {total:.0f} s processor, {share}: {len(lines)} functions, {repeated} of them again ({again:.0f} s)"


if __name__ == "__main__":
    words: list[Any] = sys.argv[1:]
    print(told(Path(words[0]), float(words[1])))
