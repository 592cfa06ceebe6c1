"""The frame log: every CAN frame as a line of `candump -l`, which can-utils, vendors' tools and `read_recording` can read."""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType
from typing import Self

from hil.errors import RecordingError


def candump_line(time_s: float, channel: str, can_id: int, data: bytes) -> str:
    """Return one line: `(0.003906) vcan0 181#3902`. Identifiers of 11 bits have three digits, of 29 bits eight."""
    identifier = f"{can_id:03X}" if can_id <= 0x7FF else f"{can_id:08X}"
    return f"({time_s:.6f}) {channel} {identifier}#{data.hex().upper()}\n"


class FrameLog:
    """Writes a frame log. A context manager; lines are buffered, so it belongs in lockstep runs and in processes beside the loop.

    Parameters
    ----------
    path : str or Path
    channel : str
        Name of the bus in the log.
    """

    def __init__(self, path: str | Path, channel: str) -> None:
        self._path = Path(path)
        self._channel = channel
        try:
            self._file = self._path.open("w", encoding="ascii", newline="\n")
        except OSError as problem:
            raise RecordingError(f"{path}: cannot be written: {problem.strerror}") from None

    def write(self, time_s: float, can_id: int, data: bytes) -> None:
        """Append one frame."""
        self._file.write(candump_line(time_s, self._channel, can_id, data))

    def close(self) -> None:
        """Flush the buffer to the disk."""
        if self._file.closed:
            return
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
        except OSError as problem:
            raise RecordingError(f"{self._path}: cannot be written: {problem.strerror}") from None

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None) -> None:
        """Close on the way out."""
        self.close()
