"""Rows of the run that is being recorded, on their way from the recorder's journal to any number of readers.

A frame to a reader is 24 bytes and a block of rows: recording, rows, columns and rows lost to this reader so far (u32 each), index of the
first row (f64); then rows x columns float64, as they stand in the journal. All little endian.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import struct
from collections import deque
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.console.timeliness import Timeliness
from hil.errors import RecordingError
from hil.recording.tail import JournalTail

FRAME = struct.Struct("<IIIId")
HISTORY_BYTES = 8_000_000
"""Rows that are kept for readers who come later: of the C-arm's forty columns a minute and a half."""
QUEUE_BYTES = 8_500_000
"""Most bytes that wait for one reader: all of the history and some seconds more. Beyond it the oldest rows are lost to it, and counted."""
LOOKS_AROUND = 10
"""Looks between two for another journal, while one is read: a run that was killed leaves its own behind."""


class Reader:
    """What waits for one reader: rows, of which the oldest are lost when there are too many, and notes, which are not."""

    def __init__(self) -> None:
        self._waiting: deque[str | Block] = deque()
        self._bytes = 0
        self._come = asyncio.Event()
        self.lost = 0

    def put(self, what: str | Block) -> None:
        """Add a note or a block of rows; never waits."""
        self._waiting.append(what)
        self._bytes += _size(what)
        while self._bytes > QUEUE_BYTES and (oldest := next((each for each in self._waiting if isinstance(each, Block)), None)):
            self._waiting.remove(oldest)
            self._bytes -= _size(oldest)
            self.lost += oldest.rows
        self._come.set()

    async def next(self) -> str | bytes:
        """Wait for the next message."""
        while not self._waiting:
            self._come.clear()
            await self._come.wait()
        what = self._waiting.popleft()
        self._bytes -= _size(what)
        return what if isinstance(what, str) else what.frame(self.lost)


class Block:
    """Some rows of a recording."""

    def __init__(self, recording: int, first: int, rows: int, columns: int, values: bytes) -> None:
        self.recording, self.first, self.rows, self.columns, self.values = recording, first, rows, columns, values

    def frame(self, lost: int) -> bytes:
        """Return the message for a reader to whom so many rows were lost."""
        return FRAME.pack(self.recording, self.rows, self.columns, lost, float(self.first)) + self.values


class RowHub:
    """Watches a folder for a journal that grows, and hands its rows to the readers.

    Parameters
    ----------
    folder : Path
        Where runs record.
    since_s : float
        Journals that were last written before this time (of the file system) are left over from another day.
    """

    def __init__(self, folder: Path, since_s: float) -> None:
        self._folder, self._since_s = folder, since_s
        self._tail: JournalTail | None = None
        self._present = ("", 0)  # name and inode of the journal that is read
        self._left: set[tuple[str, int]] = set()  # journals that were left behind by runs that were killed, by name and inode
        self._looks = 0
        self._history: deque[Block] = deque()
        self._kept = 0
        self._note = self._named = ""  # what the readers are told of, and its name
        self._readers: set[Reader] = set()
        self.number = 0
        self.recording: dict[str, Any] | None = None
        self.timeliness = Timeliness([])
        self.newest: dict[str, float | None] = {}
        self._recorded: dict[str, float | None] = {}
        self._channels: list[tuple[str, str]] = []  # of what the readers are told
        self._shown = 0  # rows of the live view

    def join(self) -> Reader:
        """Return a new reader: the present recording and its last rows wait for it already."""
        reader = Reader()
        if self._note:
            reader.put(self._note)
            for block in self._history:
                reader.put(block)
        self._readers.add(reader)
        return reader

    def leave(self, reader: Reader) -> None:
        """Forget a reader."""
        self._readers.discard(reader)

    @property
    def readers(self) -> int:
        """Number of readers."""
        return len(self._readers)

    @property
    def named(self) -> str:
        """Name of what the newest rows are of."""
        return self._named

    def look(self) -> None:
        """Take what has been recorded since the last look."""
        self._looks += 1
        if self._tail is None or self._looks % LOOKS_AROUND == 0:
            self._open_newest()
        if self._tail is None:
            return
        ended = self._tail.ended  # before the last rows are taken, so that none of them is missed
        for rows, values in self._tail.take():
            if self._named != self._present[0].removesuffix(".part"):  # the way to its start was shown meanwhile
                self._begin(self._present[0].removesuffix(".part"), list(self._tail.channels))
            self._spread(rows, values, self._tail.rows - rows)
            self._recorded = self.newest
        assert self.recording is not None
        if self._tail.rows and not self.recording["began"]:  # the journal is there before the machine is at its start
            self.recording["began"] = f"{datetime.now():%H:%M:%S}"
        if ended:
            self._tail.close()
            self._tail = None
        self.recording |= {"rows": self.timeliness.rows, "live": self._tail is not None}

    def show(self, name: str, channels: Sequence[Sequence[str]]) -> None:
        """Begin rows of which nothing is recorded; those of a recording go before."""
        self._shown = 0
        if not self._records:
            self._begin(name, [(each[0], each[1]) for each in channels])

    def take_shown(self, rows: int, values: bytes, are_ticks: bool = True) -> None:
        """Take rows of which nothing is recorded; how punctual they are is told where they are ticks."""
        if not self._records and len(values) == 8 * rows * len(self._channels):
            self._spread(rows, values, self._shown, are_ticks)
            self._shown += rows

    def take_recorded(self) -> dict[str, float | None]:
        """Return the last row that was recorded since the last call; nothing where none was."""
        taken, self._recorded = self._recorded, {}
        return taken

    @property
    def awaits(self) -> bool:
        """Whether the readers are told of a recording of which no row has come yet."""
        return self._tail is not None and not self._records and self._named == self._present[0].removesuffix(".part")

    @property
    def _records(self) -> bool:
        """Whether rows of a recording come; its journal is there before the machine is at its start."""
        return self._tail is not None and self._tail.rows > 0

    def close(self) -> None:
        """Close the journal."""
        if self._tail is not None:
            self._tail.close()

    def _open_newest(self) -> None:
        """Open the journal that was written last, unless it is the one that is read."""
        newest = max(self._growing(), default=None)
        if newest is None or (self._tail is not None and newest[1:] == self._present):
            return
        _, name, inode = newest
        try:
            tail = JournalTail(self._folder / name)
        except RecordingError:
            return  # its header is not there yet
        if self._tail is not None:
            self._left.add(self._present)
            self._tail.close()
        self._tail, self._present = tail, (name, inode)
        experiment = tail.metadata.get("experiment", {})
        recording = {"name": name.removesuffix(".part"), "rows": 0, "live": True, "began": "", "experiment": experiment.get("kind", "")}
        self.recording = recording
        self._begin(recording["name"], list(tail.channels))

    def _begin(self, name: str, channels: list[tuple[str, str]]) -> None:
        self.number += 1
        self._history.clear()
        self._kept = 0
        self.newest = {}
        self._channels, self._named = channels, name
        self.timeliness = Timeliness([channel for channel, _ in channels])
        self._note = json.dumps({"type": "recording", "number": self.number, "name": name, "channels": channels})
        for reader in self._readers:
            reader.put(self._note)

    def _growing(self) -> Iterator[tuple[int, str, int]]:
        """Yield time of writing, name and inode of the journals in the folder."""
        for path in self._folder.glob("*.part"):
            with contextlib.suppress(OSError):  # it has just become its recording
                status = path.stat()
                if status.st_mtime >= self._since_s and (path.name, status.st_ino) not in self._left:
                    yield status.st_mtime_ns, path.name, status.st_ino

    def _spread(self, rows: int, values: bytes, first: int, are_ticks: bool = True) -> None:
        block = Block(self.number, first, rows, len(self._channels), values)
        self._history.append(block)
        self._kept += len(values)
        while self._kept > HISTORY_BYTES and len(self._history) > 1:
            self._kept -= len(self._history.popleft().values)
        last = struct.unpack_from(f"<{len(self._channels)}d", values, len(values) - 8 * len(self._channels))
        if are_ticks:
            self.timeliness.take(rows, values)
        self.newest = {name: value if math.isfinite(value) else None for (name, _), value in zip(self._channels, last, strict=True)}
        for reader in self._readers:
            reader.put(block)


def _size(what: str | Block) -> int:
    return len(what) if isinstance(what, str) else len(what.values) + FRAME.size
