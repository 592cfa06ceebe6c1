"""Logs of `candump`, one frame a line: those of `candump -l` and what it prints, with any of its time stamps or none.

`-t a` and `-t A` are times of day, `-t z` counts from the first frame, `-t d` from the frame before. The last two look alike; differences
fall again and again where a count never does.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from hil.errors import RecordingError
from hil.recording.can_frames import CanFrame, CanLog, counted

_FILED = re.compile(
    r"\((?P<time>\d+(?:\.\d+)?)\)\s+(?P<channel>\S+)\s+(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:(?P<remote>R[0-8]?)|#[0-9A-Fa-f](?P<fd>(?:[0-9A-Fa-f]{2}){0,64})|(?P<data>(?:[0-9A-Fa-f]{2}){0,8}))(?:\s+[RT])?"
)
_PRINTED = re.compile(
    r"(?:\((?:(?P<time>\d+\.\d+)|(?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+))\)\s+)?(?P<channel>\S+)\s+"
    r"(?:[RT]X\s+[-B]\s+[-E]\s+)?"  # -x
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(?P<length>\d{1,2})\](?:\s*\{\d+\})?"
    r"(?:\s+(?P<remote>remote request)|(?P<data>(?:(?:\s+|`)(?:[01]{8}|[0-9A-Fa-f]{2})){0,64})(?:\s+(?:ERRORFRAME|'.*'))*)"
)
_SWAPPED = "`"
"""Between bytes that -S turned round."""

_BITS = 8
"""Letters of a byte that -i printed."""

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_ERROR_FRAME = 0x20000000
_DROPPED = re.compile(r"DROPCOUNT: dropped (\d+) CAN frames? on .*")
"""What candump -d says, in the log too, when the socket was full."""

_FALLEN = 0.5
"""A time stamp below this share of the one before it may be a difference: frames out of order are apart by milliseconds."""

_AGAIN = 0.01
"""Share of time stamps that are so, from which all are differences: a clock is set back, and a second log begins, less often."""

_LONGEST, _BLANK = 1000, 10
"""Letters of a line of candump and blank lines above it, at most, where the suffix does not say that a text is one."""

_SHORT = 6
"""A log of fewer than twice as many lines has no second fall."""


def read_candump(path: Path) -> CanLog:
    """Return the frames of a candump log in file order; RecordingError names the first line that is no frame."""
    try:
        text = path.read_bytes().decode("ascii")
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError as problem:
        number = problem.object[: problem.start].count(b"\n") + 1
        raise RecordingError(f"{path}: line {number}: no ASCII text, so no log of candump") from None
    frames: list[CanFrame] = []
    errors, dropped, notes = 0, 0, list[str]()
    stamps: set[str] = set()
    lines = text.splitlines()
    unfinished = len(lines) if len(lines) > 1 and not text.endswith("\n") else 0
    for number, line in enumerate(lines, 1):
        if not line.strip() or (errors and line.startswith("\t")):  # after an error frame `-e` explains it
            continue
        line = _COLOURS.sub("", line).strip()
        if match := _DROPPED.fullmatch(line):
            dropped += int(match[1])
            continue
        try:
            frame, stamp = _frame(line, path, number)
        except RecordingError:
            if number != unfinished:
                raise
            notes.append(f"line {number}, the last, is cut off ({line[:60]!r}) and was left out")
            break
        stamps.add(stamp)
        if len(stamps) > 1:
            raise RecordingError(f"{path}: line {number}: another kind of time stamp than in the lines before; keep the lines of one run")
        if frame.extended and frame.can_id & _ERROR_FRAME:
            errors += 1
        frames.append(frame)
    if dropped:
        notes.append(f"{counted(dropped, 'frame')} that candump itself dropped, by its own count")
    if stamps == {"count"} and _are_differences([frame.time_s for frame in frames]):
        times = itertools.accumulate(frame.time_s for frame in frames)
        frames = [frame._replace(time_s=time_s) for frame, time_s in zip(frames, times, strict=True)]
        notes.append("its time stamps are differences (candump -t d), which were summed")
    kept = [frame for frame in frames if not (frame.extended and frame.can_id & _ERROR_FRAME)]
    return CanLog(kept, [counted(errors, "error frame")] if errors else [], notes)


def is_candump(path: Path) -> bool:
    """Return whether a text begins with a line of candump."""
    try:
        with path.open(encoding="ascii", errors="replace") as file:
            line = next((one for one in (file.readline(_LONGEST).strip() for _ in range(_BLANK)) if one), "")
    except OSError:
        return False  # whoever reads it says why
    line = _COLOURS.sub("", line)
    return bool(_FILED.fullmatch(line) or _PRINTED.fullmatch(line))


def _frame(line: str, path: Path, number: int) -> tuple[CanFrame, str]:
    """Return the frame of a line, and the kind of its time stamp."""
    if match := _FILED.fullmatch(line):
        can_id, fd = int(match["id"], 16), match["fd"] is not None
        data = bytes.fromhex(match["data"] or match["fd"] or "")
        remote = match["remote"] is not None
        return CanFrame(float(match["time"]), match["channel"], can_id, len(match["id"]) == 8, remote, data, fd), "filed"
    match = _PRINTED.fullmatch(line)
    if match is None and line.startswith("***BUSMASTER"):
        raise RecordingError(f"{path}: a log of BUSMASTER; let it convert the log to .asc (Tools, Format Converters), and give that")
    if match is None:
        raise RecordingError(f"{path}: line {number}: {line[:60]!r} is no line of candump, such as `(12.003906) can0 181#3902`")
    printed = match["data"] or ""
    data = bytes(int(word, 2 if len(word) == _BITS else 16) for word in printed.replace(_SWAPPED, " ").split())
    data = data[::-1] if _SWAPPED in printed else data
    if match["remote"] is None and len(data) != int(match["length"]):
        raise RecordingError(f"{path}: line {number}: [{match['length']}] and {len(data)} bytes; they are as many, in the order of the bus")
    time_s, stamp = math.nan, "none"
    if match["time"] is not None:
        time_s, stamp = float(match["time"]), "count"
    elif match["date"] is not None:
        try:
            time_s, stamp = (datetime.fromisoformat(match["date"]) - datetime(1970, 1, 1)).total_seconds(), "date"
        except ValueError:
            raise RecordingError(f"{path}: line {number}: {match['date']} is no time") from None
    fd = len(match["length"]) == 2  # candump writes the length of CAN FD frames in two digits
    frame = CanFrame(time_s, match["channel"], int(match["id"], 16), len(match["id"]) == 8, match["remote"] is not None, data, fd)
    return frame, stamp


def _are_differences(times_s: Sequence[float]) -> bool:
    fallen = sum(time_s < _FALLEN * before for before, time_s in itertools.pairwise(times_s))
    return fallen >= max(1, min(2, len(times_s) // _SHORT), _AGAIN * len(times_s))
