"""Following a recording while it is made, from another process: the recorder's journal is read as it grows, and nobody is asked."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np

from hil.errors import RecordingError
from hil.recording.journal import complete_blocks, parse_header


class JournalFollower:
    """The rows of one journal, each once.

    A context manager.

    Attributes
    ----------
    channels : list of (name, unit), empty until the journal's header is complete.
    metadata : table that was known beforehand.
    ended : whether the recorder has turned the journal into the recording, so that no more rows will come.
    """

    def __init__(self, part: Path) -> None:
        self.path = part
        self.channels: list[tuple[str, str]] = []
        self.metadata: dict[str, Any] = {}
        self.ended = False
        self._at = 0
        self._held: BinaryIO | None = part.open("rb") if os.name == "posix" else None  # elsewhere an open file cannot be removed

    def rows(self) -> np.ndarray:
        """Return the rows (n, channels) that have come since the last call.

        Raises
        ------
        RecordingError
            The file is no journal.
        """
        gone = self._is_gone()  # asked before reading: what was written last is read all the same
        content = self._new_bytes()
        if not self.channels:
            try:
                self.channels, self.metadata, start = parse_header(self.path, content)
            except RecordingError:
                if len(content) > _LONGEST_HEADER or gone:
                    raise
                return np.empty((0, 0))
            content, self._at = content[start:], start
        blocks, end = [], 0
        for count, values, block_end in complete_blocks(content, 0, len(self.channels)):
            blocks.append(np.frombuffer(values, dtype="<f8").reshape(count, len(self.channels)))
            end = block_end
        self._at += end
        self.ended = gone
        return np.concatenate(blocks) if blocks else np.empty((0, len(self.channels)))

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None) -> None:
        """Close the file."""
        if self._held is not None:
            self._held.close()

    def _is_gone(self) -> bool:
        return os.fstat(self._held.fileno()).st_nlink == 0 if self._held is not None else not self.path.exists()

    def _new_bytes(self) -> bytes:
        if self._held is not None:
            self._held.seek(self._at)
            return self._held.read()
        try:
            with self.path.open("rb") as file:
                file.seek(self._at)
                return file.read()
        except FileNotFoundError:
            return b""


_LONGEST_HEADER = 2**24
"""Bytes after which a file without a whole header is none: a machine file and an experiment take some ten thousand."""


def journals(place: Path) -> Iterator[Path]:
    """Yield the journals in a folder, the oldest first, or that of one recording."""
    if not place.is_dir():
        part = place.with_name(place.name + ".part")
        yield from [part] if part.exists() else []
        return
    found = [(part.stat().st_mtime, part) for part in place.glob("*.part") if part.is_file()]
    yield from (part for _, part in sorted(found))
