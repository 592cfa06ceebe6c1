"""Logs of `candump -l` (`.log`), one frame a line."""

from __future__ import annotations

import re
from pathlib import Path

from hil.errors import RecordingError
from hil.recording.can_frames import CanFrame

_LINE = re.compile(
    r"\((?P<time>\d+(?:\.\d+)?)\)\s+(?P<channel>\S+)\s+(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:(?P<remote>R[0-8]?)|#[0-9A-Fa-f](?P<fd>(?:[0-9A-Fa-f]{2}){0,64})|(?P<data>(?:[0-9A-Fa-f]{2}){0,8}))(?:\s+[RT])?"
)
_ERROR_FRAME = 0x20000000


def read_candump(path: Path) -> list[CanFrame]:
    """Return all frames of a candump log in file order; RecordingError names the first line that is no frame."""
    try:
        lines = path.read_bytes().decode("ascii").splitlines()
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError as problem:
        number = problem.object[: problem.start].count(b"\n") + 1
        raise RecordingError(f"{path}: line {number}: no ASCII text, so no log of `candump -l`") from None
    frames = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        match = _LINE.fullmatch(line.strip())
        if match is None:
            raise RecordingError(f"{path}: line {number}: {line[:60]!r} is no line of `candump -l`, such as `(12.003906) can0 181#3902`")
        can_id = int(match["id"], 16)
        extended = len(match["id"]) == 8
        if not (extended and can_id & _ERROR_FRAME):
            data = bytes.fromhex(match["data"] or match["fd"] or "")
            frames.append(CanFrame(float(match["time"]), match["channel"], can_id, extended, match["remote"] is not None, data))
    return frames
