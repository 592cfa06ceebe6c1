"""The sink of a run's rows: a journal on the disk, turned into the recording at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from hil.errors import RecordingError
from hil.recording.formats import check_writable, write_recording
from hil.recording.journal import ChannelTable, Journal, part_path, read_journal

FLUSH_TIME_S = 0.5
"""Rows are handed to the operating system at least this often in recorded time: a killed process loses less than the promised second."""

FLUSH_ROWS = 512
"""Rows are handed over at least after this many, so that memory stays small at any sample rate."""


def finish(part: Path, path: Path, tables: Mapping[str, Any]) -> int:
    """Turn a journal into the recording `path`, with further metadata tables, and remove it.

    Returns
    -------
    int
        Number of rows; for 0 no file is written, because a recording has rows.

    Raises
    ------
    RecordingError
        The file cannot be written; the journal stays.
    """
    with Journal.resume(part) as journal:
        rows = journal.rows
    if rows:
        recording, _ = read_journal(part)
        try:
            write_recording(recording.with_metadata(**tables), path)
        except RecordingError as problem:
            raise RecordingError(f"{problem}; its {rows} rows are kept in {part.name}") from None
    part.unlink()
    return rows


class JournalSink:
    """Records in the calling process, for lockstep runs and other uses without real time.

    Parameters
    ----------
    path : str or Path
        The recording to be, `.mf4` or `.csv`. Until `close` its rows are in `<path>.part`.
    channels : sequence of (name, unit)
        Columns of a row; `time` is one of them.
    metadata : mapping
        Metadata known beforehand (`hil.recording.recording_metadata`).

    Raises
    ------
    RecordingError
        The file cannot be written, or an unfinished recording exists.
    """

    keeps = True

    def __init__(self, path: str | Path, channels: ChannelTable, metadata: Mapping[str, Any]) -> None:
        self.path = Path(path)
        check_writable(self.path)
        self._journal = Journal.create(part_path(self.path), channels, metadata)
        self._time = [name for name, _ in channels].index("time")
        self._buffer = np.empty((FLUSH_ROWS, len(channels)))
        self._used = 0
        self._flush_at_s = np.inf
        self._closed = False

    @property
    def rows(self) -> int:
        """Number of rows put."""
        return self._journal.rows + self._used

    def put(self, row: np.ndarray) -> None:
        """Copy one row (width,)."""
        used = self._used
        if used == 0:
            self._flush_at_s = row[self._time] + FLUSH_TIME_S
        self._buffer[used] = row
        self._used = used = used + 1
        if used == FLUSH_ROWS or row[self._time] >= self._flush_at_s:
            self._flush()

    def close(self, metadata: Mapping[str, Any] | None = None) -> int:
        """Write the recording, with further metadata tables, and remove the journal; return the number of rows (0: no file)."""
        if self._closed:
            return self._journal.rows
        self._closed = True
        try:
            self._flush()
        finally:
            self._journal.close()
        return finish(self._journal.path, self.path, metadata or {})

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None) -> None:
        """Close on the way out."""
        self.close({"ended": {"error": str(value)}} if value is not None else None)

    def _flush(self) -> None:
        self._journal.append(self._buffer[: self._used])
        self._used = 0
