"""Vector's binary logs (`.blf`).

Only times relative to the log's start are used. Its absolute start is local time in files of some tools and UTC in those of others, is
kept in milliseconds, and is missing in some; frames from before the start have wrapped, unsigned times, and channels may be out of order.
"""

from __future__ import annotations

from pathlib import Path

import can

from hil.errors import RecordingError
from hil.recording.can_frames import CanFrame

_WRAP_S = 2.0**64 * 1e-9
"""Times are unsigned counts of nanoseconds (or ten microseconds): one before the start appears this much later than it was."""


def read_blf(path: Path) -> list[CanFrame]:
    """All frames of a BLF, in order of time, in seconds since the log's start; RecordingError if it is none or damaged."""
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    frames = []
    try:
        with can.BLFReader(path) as reader:
            start_s = reader.start_timestamp
            for message in reader:
                if message.is_error_frame:
                    continue
                time_s = message.timestamp - start_s
                if time_s > _WRAP_S / 2.0:
                    time_s -= _WRAP_S
                channel, data = f"can{message.channel}", bytes(message.data)
                frames.append(CanFrame(time_s, channel, message.arbitration_id, message.is_extended_id, message.is_remote_frame, data))
    except Exception as problem:  # python-can answers a damaged file with whatever its parser ran into
        raise RecordingError(f"{path}: no BLF, or damaged: {str(problem).partition(chr(10))[0] or type(problem).__name__}") from None
    return sorted(frames, key=lambda frame: frame.time_s)
