"""The recorder: a process of its own that takes rows out of the ring and keeps them, whatever becomes of the loop.

`python -m hil.recording.recorder RING WIDTH CAPACITY PATH`, started by `RecorderProcess` with the journal already there. Standard input is
the lead the loop holds it by: on closing the recording the loop writes its last metadata there; if it ends without a word, the loop has
died, and the recorder finishes the recording on its own. Standard output says `ready`, then `done ROWS` or `error MESSAGE`.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from hil.errors import RecordingError
from hil.recording.journal import Journal, part_path
from hil.recording.ring import CONSUMED, HEARTBEAT, LOST, Ring
from hil.recording.sink import finish

DRAIN_PERIOD_S = 0.05
"""How often rows go from the ring to the disk: a twentieth of the second that may be lost, and rare enough to leave the processor alone."""

SYNC_PERIOD_S = 1.0
"""How often the disk is told to keep what it was given: a power cut costs a second, too."""

RETRY_PERIOD_S = 1.0
"""How long a full disk is left alone before the next try; meanwhile rows wait in the ring."""

BLOCK_ROWS = 1024
"""Most rows taken in one piece: 40 channels are then a third of a megabyte."""


class Drain:
    """Moves rows from a ring to a journal. The journal's length is the truth: a recorder that takes over goes on behind it."""

    def __init__(self, ring: Ring, journal: Journal) -> None:
        self._ring = ring
        self._journal = journal

    def run(self) -> None:
        """Bring everything that is in the ring into the journal; RecordingError leaves the rest where it is."""
        while True:
            rows = self._ring.take(self._journal.rows, BLOCK_ROWS)
            self._journal.append(rows)
            self._ring.counters[CONSUMED] = self._journal.rows
            if not len(rows):
                return


def finish_from_ring(ring: Ring, path: Path, tables: dict[str, Any]) -> int:
    """Bring the ring's last rows into the journal and turn it into the recording; returns the number of rows."""
    part = part_path(path)
    with Journal.resume(part) as journal:
        Drain(ring, journal).run()
    lost = ring.counters[LOST]
    return finish(part, path, {**tables, "rows_lost": lost} if lost else tables)


class _Lead:
    """Reads standard input to its end in a thread of its own."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self.words = b""
        self._parent = os.getppid()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            self.words = sys.stdin.buffer.read()
        self.ended.set()

    def wait(self, timeout_s: float) -> bool:
        """Whether the loop has closed the recording or died. A fork of the loop may hold the lead, so the parent is watched as well."""
        return self.ended.wait(timeout_s) or (os.name == "posix" and os.getppid() != self._parent)

    def last_metadata(self) -> dict[str, Any]:
        """What the loop said on closing; a table of ours where it died."""
        if self.words.endswith(b"\n"):
            return json.loads(self.words)
        return {"ended": {"error": "the loop's process ended without closing the recording"}}


def main(arguments: list[str]) -> None:
    """Record until the loop closes the recording or dies."""
    _be_modest()
    key, width, capacity, name = arguments
    path = Path(name)
    try:
        ring = Ring(int(width), int(capacity), key)
        lead = _Lead()
        with Journal.resume(part_path(path)) as journal:
            _say("ready")
            _record(ring, journal, lead)
        _say(f"done {finish_from_ring(ring, path, lead.last_metadata())}")
    except Exception as problem:  # nothing but one line must reach the person at the bench
        _say(f"error {problem if isinstance(problem, RecordingError) else f'{path}: the recorder failed: {problem!r}'}")
        raise SystemExit(1) from None


def _record(ring: Ring, journal: Journal, lead: _Lead) -> None:
    drain = Drain(ring, journal)
    next_sync_s = time.monotonic() + SYNC_PERIOD_S
    not_before_s = 0.0
    ended = False
    while not ended:
        ended = lead.wait(DRAIN_PERIOD_S)
        ring.counters[HEARTBEAT] += 1
        now_s = time.monotonic()
        if now_s < not_before_s:
            continue
        try:
            drain.run()
            if now_s >= next_sync_s:
                journal.sync()
                next_sync_s = now_s + SYNC_PERIOD_S
        except RecordingError:
            not_before_s = now_s + RETRY_PERIOD_S


def _be_modest() -> None:
    """Leave the end of the run to the loop, and the processor too: we may have inherited its priority and its core."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, range(os.cpu_count() or 1))


def _say(line: str) -> None:
    with contextlib.suppress(OSError):
        sys.stdout.write(line.replace("\n", " ") + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
