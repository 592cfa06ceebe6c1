"""Vector's binary logs (`.blf`).

Only times relative to the log's start are used. Its absolute start is local time in files of some tools and UTC in those of others, is
kept in milliseconds, and is missing in some; frames from before the start have wrapped, unsigned times, and channels may be out of order.

python-can skips what it cannot read with a line in its log, ends without an error where a file is cut off, and repeats an object of length
0 without end: here each of these is an error.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from pathlib import Path

import can

from hil.errors import RecordingError
from hil.recording.can_frames import CanFrame, CanLog, counted

_WRAP_S = 2.0**64 * 1e-9
"""Times are unsigned counts of nanoseconds: one before the start appears this much later than it was."""

_MOST_AT_ONCE = 1000
"""This many equal frames at the same nanosecond cannot come from a bus: a frame takes 47 us at 1 Mbit/s."""


class _DamagedError(Exception):
    """A fault in the file that python-can would have skipped."""


def read_blf(path: Path) -> CanLog:
    """Return the frames of a BLF in order of time, in seconds since the log's start; RecordingError if it is no BLF or damaged."""
    try:
        with _warnings_are_errors(), can.BLFReader(path) as reader:
            if path.stat().st_size < reader.file_size:
                raise _DamagedError(f"{path.stat().st_size} bytes of {reader.file_size}; it was cut off")
            found = list(_frames(reader))
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror or problem}") from None
    except Exception as problem:  # on a damaged file python-can raises any error of its parser
        raise RecordingError(f"{path}: no BLF, or damaged: {str(problem).partition(chr(10))[0] or type(problem).__name__}") from None
    frames = [frame for frame in found if frame is not None]
    errors = len(found) - len(frames)
    return CanLog(frames, [counted(errors, "error frame")] if errors else [])


def _frames(reader: can.BLFReader) -> Iterator[CanFrame | None]:
    """Yield frames, None for an error frame."""
    start_s = reader.start_timestamp
    last: CanFrame | None = None
    repeated = 0
    for message in reader:
        time_s = message.timestamp - start_s
        if time_s > _WRAP_S / 2.0:
            time_s -= _WRAP_S
        data = bytes(message.data)
        extended, remote = message.is_extended_id, message.is_remote_frame
        frame = CanFrame(time_s, f"can{message.channel}", message.arbitration_id, extended, remote, data, message.is_fd)
        repeated = repeated + 1 if frame == last else 0
        if repeated > _MOST_AT_ONCE:
            raise _DamagedError("an object of length 0")
        last = frame
        yield None if message.is_error_frame else frame


@contextlib.contextmanager
def _warnings_are_errors() -> Iterator[None]:
    """Raise python-can's log messages about a file as errors."""

    def refuse(record: logging.LogRecord) -> bool:
        raise _DamagedError(record.getMessage())

    logger = logging.getLogger("can.io.blf")
    logger.addFilter(refuse)
    try:
        yield
    finally:
        logger.removeFilter(refuse)
