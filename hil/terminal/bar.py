"""A run's progress bar on the wall clock, drawn by a process of its own, which reads the number of rows from the recorder's ring.

`python -m hil.terminal.bar RING WIDTH CAPACITY ROWS NAME`, started by `drawn_beside` before the run; it ends when its standard input does.
Drawing in the loop's process would cost it milliseconds.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator

from hil.recording import RecorderProcess
from hil.recording.recorder import be_modest
from hil.recording.ring import PRODUCED, Ring
from hil.terminal.progress import progress

LOOK_S = 0.5
"""Period at which it looks: two updates a second look smooth and leave the processor alone."""

END_S = 2.0
NICENESS = 10


@contextlib.contextmanager
def drawn_beside(recorder: RecorderProcess, rows: int, name: str) -> Iterator[None]:
    """Draw a bar on standard error from here to the end of the block, for a recording of so many rows."""
    ring = recorder.ring
    drawer = subprocess.Popen(
        [sys.executable, "-m", "hil.terminal.bar", ring.key, str(ring.width), str(ring.capacity), str(rows), name],
        stdin=subprocess.PIPE,
        pass_fds=ring.inherited,
        start_new_session=True,  # a Ctrl-C at the terminal is the loop's to answer
    )
    try:
        yield
    finally:
        assert drawer.stdin is not None
        with contextlib.suppress(OSError):
            drawer.stdin.close()
        try:
            drawer.wait(END_S)
        except subprocess.TimeoutExpired:
            drawer.kill()
            drawer.wait()


def main(arguments: list[str]) -> None:
    """Draw until standard input ends."""
    be_modest()
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    key, width, capacity, rows, name = arguments
    ring = Ring(int(width), int(capacity), key)
    ended = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.buffer.read()
        ended.set()

    threading.Thread(target=wait_for_the_end, daemon=True).start()
    with progress(refresh_Hz=1.0 / LOOK_S) as bars:
        task = bars.add_task(name, total=int(rows))
        while not ended.wait(LOOK_S):
            bars.update(task, completed=ring.counters[PRODUCED])
        bars.update(task, completed=ring.counters[PRODUCED])


if __name__ == "__main__":
    main(sys.argv[1:])
