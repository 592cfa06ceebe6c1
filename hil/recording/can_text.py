"""Text logs of Vector's tools and BUSMASTER (`.asc`) and of PEAK's (`.trc`), read by python-can.

python-can's readers pass over what they do not know without a word. Here they read from a text that knows which lines became frames: the
others are counted, and a line that should have been a frame is an error.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import can

from hil.errors import RecordingError
from hil.recording.can_frames import CanFrame, CanLog, counted

_ASC_HEAD = re.compile(
    r"(?:date\b|base\b|no\s+internal\s+events|internal\s+events|//|begin\s+triggerblock|end\s+triggerblock"
    r"|\d+\.\d+\s+start\s+of\s+measurement|previous\s+log\s+file).*",
    re.IGNORECASE,
)
_ASC_BASE = re.compile(r"\s*base\s", re.IGNORECASE)
_ASC_FRAME = re.compile(r"\d+\.\d+\s+(?:CANFD\s+)?\d+\s+\S+\s+(?:Rx|Tx)\b.*|\d+\.\d+\s+CANFD\s+\d+\s+(?:Rx|Tx)\b.*", re.IGNORECASE)
_ASC_REQUEST = re.compile(r"\d+\.\d+\s+\d+\s+\S+\s+TxRq\b.*", re.IGNORECASE)
_ASC_DIFFERENCES = re.compile(r"base\s+\w+\s+timestamps\s+relative\b", re.IGNORECASE | re.MULTILINE)
_FD_FORMAT, _REMOTE = 0x1000, 0x10
"""Flags of a CANFD line: of CAN FD format, and remote. Tools write frames of classic CAN so, too."""

_TRC_VERSION = re.compile(r"^\s*;\$FILEVERSION\s*=\s*(\S+)", re.MULTILINE)
_TRC_START = re.compile(r"^\s*;\$STARTTIME.*$", re.MULTILINE)
_TRC_WITHOUT_RESERVED = re.compile(r"^(\s*\d+\)\s+[\d.]+\s+\d+\s+(?:Rx|Tx)\s+[0-9A-Fa-f]+)(\s+\d+)", re.MULTILINE)
_TRC_VERSIONS = ("1.0", "1.1", "1.2", "1.3", "2.0", "2.1")
_TRC_OTHERS = {"ST": "status row", "EC": "row of error counters", "ER": "error frame", "EV": "event"}
_TRC_OTHERS |= {"WARNG": "warning", "ERROR": "error row", "FFFFFFFF": "status row"}
"""Types of rows that are no frames."""


class WatchedText(io.StringIO):
    """A text that knows which of its lines were passed over."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.number = 0
        self.line = ""
        self.passed: list[tuple[int, str]] = []

    def __next__(self) -> str:  # type: ignore[override]  # as StringIO's own
        """Return the next line without its end; the one before, if it became no frame, was passed over."""
        if self.line:
            self.passed.append((self.number, self.line))
        self.line = ""
        self.line = super().__next__().strip()
        self.number += 1
        return self.line

    def taken(self) -> str:
        """Return the current line, which became a frame."""
        line, self.line = self.line, ""
        return line


def read_asc(path: Path) -> CanLog:
    """Return the frames of an ASC log, in seconds by its own time stamps; RecordingError names a line that should have been a frame."""
    lines = [line.lower() if _ASC_BASE.match(line) else line for line in text_of(path).splitlines()]  # python-can knows `hex`, not `HEX`
    first = next((k for k, line in enumerate(lines) if not _ASC_HEAD.fullmatch(line.strip())), len(lines))
    header = "\n".join(lines[:first])
    lines.insert(first, "")  # python-can takes the line after the header for a part of it
    watched = WatchedText("\n".join(lines))
    differences = _ASC_DIFFERENCES.search(header) is not None
    frames: list[CanFrame] = []
    counts: Counter[str] = Counter()
    unknown: list[str] = []
    for message, line in messages_of_text(can.ASCReader, watched, path, inserted=first + 1):
        if message.is_error_frame:
            counts["error frame"] += 1
        elif _ASC_REQUEST.fullmatch(line):
            counts["transmit request"] += 1
        else:
            frames.append(_asc_frame(message, line))
    for number, line in watched.passed:
        number -= number > first
        if _ASC_FRAME.fullmatch(line):
            raise RecordingError(f"{path}: line {number}: {line[:60]!r} is no frame of an ASC log")
        if not _ASC_HEAD.fullmatch(line):
            unknown.append(f"line {number}: {line[:40]!r}")
    if differences:
        frames = _summed(frames, lines)
    not_taken = [counted(number, what) for what, number in counts.items()]
    if unknown:
        not_taken.append(f"{counted(len(unknown), 'line')} that {'is no frame' if len(unknown) == 1 else 'are no frames'} ({unknown[0]})")
    return CanLog(frames, not_taken, ["its time stamps are differences (timestamps relative), which were summed"] if differences else [])


def read_trc(path: Path) -> CanLog:
    """Return the frames of a TRC log of any version, in seconds since its start; RecordingError names a line that is no row of it."""
    text = _TRC_START.sub(";", text_of(path))  # times since the start keep their microseconds; times of day would lose them
    found = _TRC_VERSION.search(text)
    version = found[1] if found else "1.0"
    if version not in _TRC_VERSIONS:
        raise RecordingError(f"{path}: version {version[:20]} of TRC; {', '.join(_TRC_VERSIONS)} can be read")
    if version == "1.2":  # as 1.3, without its reserved column
        text = _TRC_WITHOUT_RESERVED.sub(r"\1 -\2", text.replace(found[0] if found else "", ";$FILEVERSION=1.3", 1))
    watched = WatchedText(text)
    frames = [_frame(message) for message, _ in messages_of_text(can.TRCReader, watched, path)]
    counts: Counter[str] = Counter()
    for number, line in watched.passed:
        if line.startswith(";"):
            continue
        kind = next((what for what in line.upper().split()[1:5] if what in _TRC_OTHERS), "")
        if not kind:
            raise RecordingError(f"{path}: line {number}: {line[:60]!r} is no row of a TRC log of version {version}")
        counts[_TRC_OTHERS[kind]] += 1
    return CanLog(frames, [counted(number, what) for what, number in counts.items()])


def text_of(path: Path) -> str:
    """Return the text of a log; RecordingError if it cannot be read."""
    try:
        return path.read_bytes().decode("utf-8-sig", errors="replace")  # names and comments may be of any code page
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None


def messages_of_text(
    reader: Callable[[io.StringIO], can.io.generic.MessageReader], watched: WatchedText, path: Path, inserted: int = 0
) -> Iterator[tuple[can.Message, str]]:
    """Yield python-can's messages and their lines; what it raises becomes a RecordingError that names the line."""
    try:
        for message in reader(watched):
            yield message, watched.taken()
    except RecordingError:
        raise
    except Exception:  # on a damaged line python-can raises any error of its parser
        number = watched.number - (0 < inserted <= watched.number)
        raise RecordingError(f"{path}: line {number}: {watched.line[:60]!r} is no frame of a {path.suffix} log") from None


def _frame(message: can.Message) -> CanFrame:
    data = bytes(message.data)
    extended, remote = message.is_extended_id, message.is_remote_frame
    return CanFrame(message.timestamp, f"can{message.channel}", message.arbitration_id, extended, remote, data, message.is_fd)


def _asc_frame(message: can.Message, line: str) -> CanFrame:
    """Return a frame; in CANFD lines the flags say what it is, where python-can takes one without data for a remote frame."""
    frame = _frame(message)
    if not message.is_fd:
        return frame
    cells = line.split()
    place = 8 if cells[5].isdigit() else 9  # of the number of bytes, behind a name or not
    try:
        flags = int(cells[place + int(cells[place]) + 3], 16)
    except (IndexError, ValueError):
        return frame
    return frame._replace(fd=bool(flags & _FD_FORMAT), remote=bool(flags & _REMOTE))


def _summed(frames: list[CanFrame], lines: list[str]) -> list[CanFrame]:
    """Return the frames with the sum of all time stamps up to theirs; frames and stamped lines are in the same order."""
    total = 0.0
    summed = []
    waiting = iter(frames)
    frame = next(waiting, None)
    for line in lines:
        stamp = re.match(r"\s*(\d+\.\d+)\s", line)
        if stamp is None or frame is None:
            continue
        total += float(stamp[1])
        if _ASC_FRAME.fullmatch(line.strip()) and not _ASC_REQUEST.fullmatch(line.strip()):
            summed.append(frame._replace(time_s=total))
            frame = next(waiting, None)
    return summed
