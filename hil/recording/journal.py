"""The journal: the crash-safe file of a recording while it is being made.

`NAME.mf4.part` holds a header (channels and metadata) and blocks of rows in the order of recording, each block with its own length and
checksum. A block is handed to the operating system in one write, so a process that is killed loses at most the block it was gathering; an
incomplete block at the end is recognised and left out.

    file    = MAGIC, header length u32, crc32 of header u32, header (TOML), block*
    block   = BLOCK, rows u32, crc32 u32, rows x channels float64
    all little endian; crc32 of a block covers its row count and its values
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

from hil.errors import RecordingError
from hil.recording.metadata import metadata_text, parse_metadata
from hil.recording.recording import Channel, Recording

MAGIC = b"ISOJRNL1"
BLOCK = b"ROWS"
_LENGTHS = struct.Struct("<II")
_BLOCK_HEADER = struct.Struct("<4sII")

ChannelTable = Sequence[tuple[str, str]]
"""(name, unit) of every column of a row, `time` first."""


def part_path(path: Path) -> Path:
    """Return the path of the journal of a recording `path`."""
    return path.with_name(path.name + ".part")


class Journal:
    """A journal open for appending.

    Use `Journal.create` for a new one and `Journal.resume` to continue one that was left behind.
    """

    def __init__(self, path: Path, handle: int, width: int, rows: int, size: int) -> None:
        self.path = path
        self.width = width
        self.rows = rows
        """Complete rows in the file."""
        self._handle = handle
        self._size = size
        _lock(handle, path)

    @classmethod
    def create(cls, path: Path, channels: ChannelTable, metadata: Mapping[str, Any]) -> Journal:
        """Start a journal.

        Raises
        ------
        RecordingError
            The file exists (it holds rows that have not been read), or cannot be written.
        """
        names = [name for name, _ in channels]
        Recording({name: Channel(unit, np.empty(0)) for name, unit in channels}, metadata)  # raises errors here, not when it is read back
        if len(set(names)) != len(names):
            raise RecordingError(f"{path}: a channel name stands twice in {', '.join(names)}")
        header = metadata_text({**metadata, "journal_channels": [list(channel) for channel in channels]}).encode()
        journal = cls(path, _open_new(path), len(channels), 0, 0)
        try:
            journal._write(MAGIC + _LENGTHS.pack(len(header), zlib.crc32(header)) + header)
        except RecordingError:
            journal.close()
            path.unlink(missing_ok=True)
            raise
        return journal

    @classmethod
    def resume(cls, path: Path) -> Journal:
        """Continue after the last complete block; an incomplete one is cut off."""
        content = _read(path)
        channels, _, start = parse_header(path, content)
        rows, size = 0, start
        for count, _, end in blocks_in(content, start, len(channels)):
            rows, size = rows + count, end
        journal = cls(path, _open(path, os.O_RDWR), len(channels), rows, size)
        journal._cut_off_rest()
        return journal

    def append(self, rows: np.ndarray) -> None:
        """Hand rows (n, width) to the operating system: after this call they survive the end of the process.

        Raises
        ------
        RecordingError
            The disk is full or failing; earlier rows are still readable, none of these is half written, and the call may be repeated.
        """
        if not len(rows):
            return
        values = np.ascontiguousarray(rows, dtype="<f8").tobytes()
        count = len(rows)
        self._write(_BLOCK_HEADER.pack(BLOCK, count, _block_checksum(count, values)) + values)
        self.rows += count

    def sync(self) -> None:
        """Flush everything to the disk: after this call it survives a power cut."""
        try:
            os.fsync(self._handle)
        except OSError as problem:
            raise RecordingError(f"{self.path}: cannot be written: {problem.strerror}") from None

    def close(self) -> None:
        """Close the file."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None) -> None:
        """Close on the way out."""
        self.close()

    def _write(self, content: bytes) -> None:
        left = memoryview(content)
        try:
            while left:
                left = left[os.write(self._handle, left) :]
        except OSError as problem:
            self._cut_off_rest()
            raise RecordingError(f"{self.path}: cannot be written: {problem.strerror}; the {self.rows} rows before are kept") from None
        self._size += len(content)

    def _cut_off_rest(self) -> None:
        os.ftruncate(self._handle, self._size)
        os.lseek(self._handle, self._size, os.SEEK_SET)


def recover(part: Path) -> Recording:
    """Read all complete rows of a journal as a recording.

    Returns
    -------
    Recording
        Its metadata give under `recovered` the number of rows and of bytes after them that could not be read.

    Raises
    ------
    RecordingError
        The file is no journal, its header is damaged, or it holds no complete row.
    """
    recording, unread = read_journal(part)
    return recording.with_metadata(recovered={"rows": recording.rows, "unread_bytes": unread})


def read_journal(part: Path) -> tuple[Recording, int]:
    """Read the complete rows of a journal, and the number of bytes after them."""
    content = _read(part)
    channels, metadata, start = parse_header(part, content)
    blocks, end = [], start
    for count, values, block_end in blocks_in(content, start, len(channels)):
        blocks.append(np.frombuffer(values, dtype="<f8").reshape(count, len(channels)))
        end = block_end
    if not blocks:
        raise RecordingError(f"{part}: holds no complete row")
    table = np.concatenate(blocks)
    try:
        recording = Recording({name: Channel(unit, table[:, column]) for column, (name, unit) in enumerate(channels)}, metadata)
    except RecordingError as problem:
        raise RecordingError(f"{part}: {problem}") from None
    return recording, len(content) - end


def _open_new(path: Path) -> int:
    """Create the file; one that was left behind without a row is replaced."""
    new = os.O_RDWR | os.O_CREAT | os.O_EXCL
    try:
        return _open(path, new)
    except FileExistsError:
        with Journal.resume(path) as left:
            rows = left.rows
    if rows:
        name = path.name.removesuffix(".part")
        raise RecordingError(
            f"{path}: {rows} rows of a recording that was cut short; keep it with `isocenter convert {name} OTHER.mf4`, or delete it"
        )
    path.unlink()
    return _open(path, new)


def _open(path: Path, flags: int) -> int:
    try:
        return os.open(path, flags | getattr(os, "O_BINARY", 0), 0o644)
    except FileExistsError:
        raise
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be written: {problem.strerror}") from None


def _lock(handle: int, path: Path) -> None:
    """Lock the file for one writer, where the system has such locks (not on Windows); the lock ends with its process."""
    if fcntl is None:
        return
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise RecordingError(f"{path}: is being recorded by another process; choose another name") from None
    except OSError:
        return  # a file system without locks


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None


def parse_header(path: Path, content: bytes) -> tuple[list[tuple[str, str]], dict[str, Any], int]:
    """Return channels, metadata and the offset of the first block."""
    start = len(MAGIC) + _LENGTHS.size
    if content[: len(MAGIC)] != MAGIC or len(content) < start:
        raise RecordingError(f"{path}: no journal of a recording")
    length, checksum = _LENGTHS.unpack_from(content, len(MAGIC))
    header = content[start : start + length]
    if len(header) != length or zlib.crc32(header) != checksum:
        raise RecordingError(f"{path}: the header is damaged")
    metadata = parse_metadata(header.decode(), str(path))
    channels = [(str(name), str(unit)) for name, unit in metadata.pop("journal_channels")]
    return channels, metadata, start + length


def blocks_in(content: bytes, start: int, width: int) -> Iterator[tuple[int, memoryview, int]]:
    """Yield (rows, values, end) of every block up to the first that is incomplete or damaged."""
    view = memoryview(content)
    while start + _BLOCK_HEADER.size <= len(content):
        magic, count, checksum = _BLOCK_HEADER.unpack_from(content, start)
        begin = start + _BLOCK_HEADER.size
        end = begin + count * width * 8
        if magic != BLOCK or end > len(content) or _block_checksum(count, view[begin:end]) != checksum:
            return
        yield count, view[begin:end], end
        start = end


def _block_checksum(count: int, values: bytes | memoryview) -> int:
    return zlib.crc32(values, zlib.crc32(count.to_bytes(4, "little")))
