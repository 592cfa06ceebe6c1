"""Reading a journal while another process writes it, at no cost to that process: what a live view is drawn from."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hil.errors import RecordingError
from hil.recording.journal import blocks_in, parse_header

MOST_BYTES = 4_000_000
"""Most bytes read at once: more wait for the next time."""
LONGEST_HEADER = 16_000_000


class JournalTail:
    """The rows of a journal, block by block, as they are written.

    Parameters
    ----------
    path : Path
        The journal, `NAME.mf4.part`.

    Attributes
    ----------
    channels : list of (name, unit)
    metadata : dict
    rows : int
        Rows taken so far.

    Raises
    ------
    RecordingError
        It is no journal, or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = 0
        try:
            self._handle = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        except OSError as problem:
            raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None
        self.channels: list[tuple[str, str]]
        self.metadata: dict[str, Any]
        try:
            self.channels, self.metadata, self._offset = parse_header(path, os.pread(self._handle, LONGEST_HEADER, 0))
        except BaseException:
            os.close(self._handle)
            raise

    def take(self) -> Iterator[tuple[int, bytes]]:
        """Yield (rows, values) of every complete block that has come since: values are rows x channels float64, little endian."""
        content = os.pread(self._handle, MOST_BYTES, self._offset)
        begin = self._offset
        for count, values, end in blocks_in(content, 0, len(self.channels)):
            self.rows += count
            self._offset = begin + end
            yield count, bytes(values)

    @property
    def ended(self) -> bool:
        """Whether the journal was turned into its recording, or removed: nothing is written any more."""
        try:
            return not os.path.samestat(os.fstat(self._handle), self.path.stat())
        except OSError:
            return True

    def close(self) -> None:
        """Close the file."""
        os.close(self._handle)
