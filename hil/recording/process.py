"""The loop's side of the recorder process, which costs the loop one copy and one counter per row."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from hil.errors import LoopAbortedError, RecordingError
from hil.files.toml_text import plain
from hil.recording.formats import check_writable
from hil.recording.journal import ChannelTable, Journal, part_path
from hil.recording.recorder import finish_from_ring, tell
from hil.recording.ring import BEAT, CONSUMED, LOST, PRODUCED, RECORDER, Ring

CAPACITY_ROWS = 32768
"""Rows that the ring holds: two minutes at 256 Hz, half a minute at 1 kHz. For this long the disk may be full or the recorder missing."""

STANDARD_ERROR = 2

STALL_S = 0.9
"""Longest silence of the recorder, which goes round every 50 ms and does not wait for the disk: beyond, it is stopped or hangs, and a power
cut or crash would cost more than the second that may be lost."""

CLOSE_TIMEOUT_S = 120.0
"""Longest time for a recorder to finish; the rows of an hour at 256 Hz take less."""


class RecorderProcess:
    """Records in a separate process, for runs on the wall clock.

    A context manager. `put` copies a row into shared memory and does not allocate, wait or call the system. The recorder writes the rows to
    disk every 50 ms. If the recorder is killed, another takes over at the end of its journal, without action by the loop; if the loop's
    process is killed, the recorder finishes the recording; if all are, the journal has all but the last tenth of a second, and
    `read_recording` reads it.

    Parameters
    ----------
    path : str or Path
        The recording to be, `.mf4` or `.csv`. Until `close` its rows are in `<path>.part`.
    channels : sequence of (name, unit)
        Columns of a row; `time` is one of them.
    metadata : mapping
        Metadata known beforehand (`hil.recording.recording_metadata`).
    on_stall : callable, optional
        Takes in words, once, that the recorder stands still; it is said on standard error, too, and `put` goes on. Without it `put` raises.

    Raises
    ------
    RecordingError
        The file cannot be written, an unfinished recording exists, or the recorder does not start.
    """

    keeps = True

    def __init__(
        self,
        path: str | Path,
        channels: ChannelTable,
        metadata: Mapping[str, Any],
        capacity_rows: int = CAPACITY_ROWS,
        on_stall: Callable[[str], None] | None = None,
    ) -> None:
        self.path = Path(path).absolute()
        check_writable(self.path)
        Journal.create(part_path(self.path), channels, metadata).close()
        self.ring = Ring(len(channels), capacity_rows)
        self._counters = self.ring.counters
        self._rows = self.ring.rows
        self._capacity = capacity_rows
        self._produced = 0
        self._closed = self._stalled = False
        self._on_stall = on_stall
        self._beat, self._beat_s = -1, 0.0  # the recorder's newest round, and when it was first seen
        self._recorder = self._start()
        self._await_ready()

    @property
    def rows(self) -> int:
        """Number of rows put."""
        return self._produced

    @property
    def rows_kept(self) -> int:
        """Number of rows in the journal, which outlive every process."""
        return self._counters[CONSUMED]

    @property
    def rows_lost(self) -> int:
        """Number of rows lost because the ring was full."""
        return self._counters[LOST]

    @property
    def pid(self) -> int:
        """Process id of the present recorder."""
        return self._counters[RECORDER]

    def put(self, row: np.ndarray) -> None:
        """Copy one row (width,); if the ring is full the row is lost and counted.

        Raises
        ------
        LoopAbortedError
            The recorder stands still, and nobody wants to go on; the row is kept.
        """
        produced = self._produced
        if produced - self._counters[CONSUMED] >= self._capacity:
            self._counters[LOST] += 1
        else:
            self._rows[produced % self._capacity] = row
            self._produced = produced = produced + 1
            self._counters[PRODUCED] = produced
        beat, now_s = self._counters[BEAT], time.monotonic()
        if beat != self._beat:
            self._beat, self._beat_s, self._stalled = beat, now_s, False
        elif not self._stalled and now_s - self._beat_s > STALL_S:
            self._stalled = True
            said = f"{self.path}: the recorder (process {self.pid}) has stood still for {now_s - self._beat_s:.1f} s"
            if self._on_stall is None:
                raise LoopAbortedError(f"{said}; the motors were stopped and {produced} rows are kept")
            self._on_stall(said)
            tell(STANDARD_ERROR, f"{said}; the run goes on, {self._capacity} rows wait in memory, later ones are lost")

    def close(self, metadata: Mapping[str, Any] | None = None) -> int:
        """Write the recording, with further metadata tables, and end the recorder.

        Returns
        -------
        int
            Number of rows recorded; 0: no file was written.

        Raises
        ------
        RecordingError
            The file cannot be written; the rows are kept in `<path>.part`.
        """
        if self._closed:
            return self._produced
        self._closed = True
        tables = plain(metadata or {})
        try:
            answer = self._end_recorder((json.dumps(tables) + "\n").encode())
            if answer.startswith("done "):
                return int(answer.removeprefix("done "))
            return finish_from_ring(self.ring, self.path, tables)  # the recorder was killed or failed; this raises the reason
        finally:
            self._counters = self._rows = None  # type: ignore[assignment]
            self.ring.close()

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None) -> None:
        """Close on the way out."""
        self.close({"ended": {"error": str(value)}} if value is not None else None)

    def _start(self) -> subprocess.Popen[bytes]:
        ring = self.ring
        terminal = os.dup(STANDARD_ERROR) if ring.inherited else -1  # -1 on Windows, where nothing is inherited
        try:
            return subprocess.Popen(
                [sys.executable, "-m", "hil.recording.recorder", ring.key, *map(str, (ring.width, ring.capacity, self.path, terminal))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                pass_fds=(*ring.inherited, terminal) if ring.inherited else (),
                start_new_session=True,  # a Ctrl-C at the terminal is for the loop
            )
        finally:
            if terminal >= 0:
                os.close(terminal)

    def _await_ready(self) -> None:
        assert self._recorder.stdout is not None
        answer = self._recorder.stdout.readline().decode().strip()
        if answer != "ready":
            self._closed = True
            self._end_recorder(b"")
            part_path(self.path).unlink(missing_ok=True)
            raise RecordingError(answer.removeprefix("error ") or f"{self.path}: the recorder process did not start")

    def _end_recorder(self, words: bytes) -> str:
        """Send the recorder the last metadata and wait for its answer; "" if it was killed."""
        recorder = self._recorder
        try:
            output, _ = recorder.communicate(words, timeout=0.0 if self._stalled else CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            os.killpg(recorder.pid, signal.SIGKILL) if hasattr(os, "killpg") else recorder.kill()
            output, _ = recorder.communicate()
        lines = output.decode(errors="replace").splitlines()
        return next((line for line in lines if line.startswith("done ")), "")
