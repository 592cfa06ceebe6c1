"""The recorder: a separate process that takes rows out of the ring and keeps them even if the loop dies.

`python -m hil.recording.recorder RING WIDTH CAPACITY PATH TERMINAL`, started by `RecorderProcess` with the journal already there.
Standard input is its lead, held by the loop: on closing the recording the loop writes its last metadata there; if it ends without them,
the loop has died, and the recorder finishes the recording on its own. Standard output says `ready`, then `done ROWS` or `error MESSAGE`.
A disk that fills meanwhile is told at once through the descriptor TERMINAL.

Where processes can be forked, the started process only waits: it forks the one that records, and another if that is killed. So a recorder
is replaced within a millisecond or two, and not by the loop, whose process would have to be copied in the middle of a tick.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

from hil.errors import RecordingError
from hil.recording.journal import Journal, part_path
from hil.recording.ring import BEAT, CONSUMED, LOST, RECORDER, Ring
from hil.recording.sink import finish

DRAIN_PERIOD_S = 0.05
"""Interval at which rows go from the ring to the disk: a twentieth of the second that may be lost, and long enough to cost little time."""

SYNC_PERIOD_S = 1.0
"""Interval at which the disk is flushed, so that a power cut costs a second at most."""

RETRY_PERIOD_S = 1.0
"""Pause before the next try on a full disk; meanwhile rows wait in the ring."""

BLOCK_ROWS = 1024
"""Most rows taken at once: 40 channels then make a third of a megabyte."""


DYING_S = 1.0
"""Time to wait for the end of a dying process, which closes its files a moment before."""

MOST_RESTARTS = 5
"""Most replacements of a recorder; if more die, rows wait in the ring, and the loop's process writes them at the end."""


class Drain:
    """Moves rows from a ring to a journal. A recorder that takes over continues at the journal's end."""

    def __init__(self, ring: Ring, journal: Journal) -> None:
        self._ring = ring
        self._journal = journal

    def run(self) -> None:
        """Move everything in the ring into the journal; after a RecordingError the rest stays in the ring."""
        while True:
            rows = self._ring.take(self._journal.rows, BLOCK_ROWS)
            self._journal.append(rows)
            self._ring.counters[CONSUMED] = self._journal.rows
            if not len(rows):
                return


def finish_from_ring(ring: Ring, path: Path, tables: dict[str, Any]) -> int:
    """Move the ring's last rows into the journal and turn it into the recording; return the number of rows."""
    part = part_path(path)
    with Journal.resume(part) as journal:
        Drain(ring, journal).run()
    lost = ring.counters[LOST]
    return finish(part, path, {**tables, "rows_lost": lost} if lost else tables)


class _Lead:
    """Reads standard input to its end in a separate thread."""

    def __init__(self, loop: _LoopProcess) -> None:
        self.ended = threading.Event()
        self.words = b""
        self._loop = loop
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            self.words = sys.stdin.buffer.read()
        self.ended.set()

    def wait(self, timeout_s: float) -> bool:
        """Return whether the loop has closed the recording or died.

        A fork of the loop may hold the lead, so its process is watched as well.
        """
        return self.ended.wait(timeout_s) or self._loop.gone()

    def last_metadata(self) -> dict[str, Any] | None:
        """Return the loop's metadata on closing, or a table of this process where the loop died.

        None where the loop gave them to a recorder that was killed afterwards.
        """
        if self.words.endswith(b"\n"):
            said: dict[str, Any] | None = json.loads(self.words)
            return said
        return {"ended": {"error": "the loop's process ended without closing the recording"}} if self._loop.gone(DYING_S) else None


class _LoopProcess:
    """The process that started this one."""

    def __init__(self) -> None:
        self._pid = os.getppid()
        self._handle = -1
        if hasattr(os, "pidfd_open"):
            with contextlib.suppress(OSError):
                self._handle = os.pidfd_open(self._pid)

    def gone(self, timeout_s: float = 0.0) -> bool:
        """Return whether it has ended, or ends within this time; on Windows, where nothing forks, the lead's end decides."""
        if self._handle >= 0:
            return bool(select.select([self._handle], [], [], timeout_s)[0])
        if os.name != "posix":
            return timeout_s > 0.0
        until_s = time.monotonic() + timeout_s
        while True:
            try:
                os.kill(self._pid, 0)
            except ProcessLookupError:
                return True
            if time.monotonic() >= until_s:
                return False
            time.sleep(DRAIN_PERIOD_S)


def main(arguments: list[str]) -> None:
    """Record until the loop closes the recording or dies."""
    be_modest()
    key, width, capacity, name, terminal = arguments
    loop = _LoopProcess()
    ring = Ring(int(width), int(capacity), key)
    if not hasattr(os, "fork"):
        raise SystemExit(_record_to_the_end(ring, Path(name), loop, int(terminal)))
    for _ in range(1 + MOST_RESTARTS):
        child = os.fork()
        if child == 0:
            os._exit(_record_to_the_end(ring, Path(name), loop, int(terminal)))
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if status >= 0:  # it was not killed; a recorder that gave up would do so again
            raise SystemExit(status)


def _record_to_the_end(ring: Ring, path: Path, loop: _LoopProcess, terminal: int) -> int:
    """Record and return the exit status: 0 for a written recording, 1 where it failed or is left to the loop."""
    ring.counters[RECORDER] = os.getpid()
    try:
        lead = _Lead(loop)
        with Journal.resume(part_path(path)) as journal:
            _say("ready")
            _record(ring, journal, lead, terminal)
        tables = lead.last_metadata()
        if tables is None:
            return 1
        _say(f"done {finish_from_ring(ring, path, tables)}")
    except Exception as problem:  # the operator gets one line only
        _say(f"error {problem if isinstance(problem, RecordingError) else f'{path}: the recorder failed: {problem!r}'}")
        return 1
    return 0


def _record(ring: Ring, journal: Journal, lead: _Lead, terminal: int) -> None:
    drain, flush = Drain(ring, journal), _Flush(journal)
    next_sync_s = time.monotonic() + SYNC_PERIOD_S
    not_before_s = 0.0
    ended = told = False
    while not ended:
        ended = lead.wait(DRAIN_PERIOD_S)
        ring.counters[BEAT] += 1
        now_s = time.monotonic()
        if now_s < not_before_s:
            continue
        try:
            drain.run()
            told = False
            if now_s >= next_sync_s:
                flush.begin()
                next_sync_s = now_s + SYNC_PERIOD_S
        except RecordingError as problem:
            not_before_s = now_s + RETRY_PERIOD_S
            if not told:
                told = True
                tell(terminal, f"{problem}; {ring.capacity} rows wait in memory for room, later ones are lost: free some")


class _Flush:
    """Flushes the journal to the disk in a thread, because a busy disk may take seconds, and the recorder must not seem to stand still."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """Begin a flush, unless one is still under way."""
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._flush, daemon=True)
            self._thread.start()

    def _flush(self) -> None:
        with contextlib.suppress(RecordingError):  # a disk that fails says so to the next rows
            self._journal.sync()


def tell(terminal: int, line: str) -> None:
    """Write a line where the operator sees it, while the run goes on; a terminal that takes nothing now is not waited for."""
    with contextlib.suppress(OSError, ValueError):
        if select.select([], [terminal], [], 0.0)[1]:
            os.write(terminal, f"isocenter: {line}\n".encode())


def be_modest() -> None:
    """Ignore signals that end the run, and give up priority and core that may be inherited from the loop."""
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
