"""CAN frames in tables: python-can's CSV and SQLite, and the bus logging of MDF 4, which loggers of several makers write."""

from __future__ import annotations

import io
import math
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import can

from hil.errors import RecordingError
from hil.files.regular import check_regular
from hil.recording.can_frames import CanFrame, CanLog, counted
from hil.recording.can_order import as_logged
from hil.recording.can_text import WatchedText, messages_of_text, text_of
from hil.recording.said import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from asammdf import MDF

_CLASSIC_BYTES = 8
"""These tables do not say which frames are of CAN FD; one of more bytes is."""

_BUS_EVENT = 0x2
"""Flag of a channel group of MDF 4 whose rows are a bus's events (ASAM MDF 4.1, cg_flags)."""

_FRAME_CHANNELS = ("CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame", "CAN_OverloadFrame")


class Group(Protocol):
    """A channel group of a file."""

    channels: Sequence[_Named]
    channel_group: _Head


class _Named(Protocol):
    name: str
    bit_count: int
    conversion: Any


class _Head(Protocol):
    cycles_nr: int
    samples_byte_nr: int


def read_frames_csv(path: Path) -> CanLog:
    """Return the frames of python-can's CSV; RecordingError names a line that is none."""
    watched = WatchedText(text_of(path).strip() + "\n")
    return _log((message for message, _ in messages_of_text(can.CSVReader, watched, path)), path)


def read_frames_sqlite(path: Path) -> CanLog:
    """Return the frames of the table `messages` of an SQLite file, as python-can writes it.

    Raises
    ------
    RecordingError
        The file is damaged, or has no such table.
    """
    check_regular(path, RecordingError)
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
            if base.execute("SELECT type FROM sqlite_master WHERE name = 'messages'").fetchall() != [("table",)]:  # a view may have no end
                raise RecordingError(f"{path}: has no table `messages` of CAN frames as python-can writes it")
            rows = base.execute("SELECT ts, arbitration_id, extended, remote, error, dlc, data FROM messages").fetchall()
            return _log((_message(*row) for row in rows), path)
    except (sqlite3.Error, OverflowError, TypeError, ValueError) as problem:
        raise RecordingError(
            f"{path}: no SQLite file of CAN frames as python-can writes it, or damaged: {printable(str(problem))}"
        ) from None


def _message(time_s: float, can_id: int, extended: int, remote: int, error: int, length: int, data: bytes | None) -> can.Message:
    return can.Message(
        float(time_s), int(can_id), bool(extended), bool(remote), bool(error), dlc=int(length), data=None if remote else data or b""
    )


def has_only_frames(mdf: MDF) -> bool:
    """Return whether all that is in an MDF file are frames of CAN buses."""
    groups = [group for group in cast("Sequence[Group]", mdf.groups) if group.channel_group.cycles_nr]
    return bool(groups) and all(is_of_frames(group) for group in groups)


def is_of_frames(group: Group) -> bool:
    """Return whether the rows of a channel group are CAN frames."""
    flags = getattr(group.channel_group, "flags", 0)  # version 3 has none
    return bool(flags & _BUS_EVENT) and any(channel.name in _FRAME_CHANNELS for channel in group.channels)


def frames_of_mdf(content: bytes, path: Path) -> CanLog:
    """Return the frames of an MDF file, in the order of the log; what python-can raises of a damaged file comes through."""
    with can.MF4Reader(io.BytesIO(content)) as reader:
        log = _log(reader, path, fd_is_said=True)
    return replace(log, frames=as_logged(log.frames))


def _log(messages: Iterable[can.Message], path: Path, *, fd_is_said: bool = False) -> CanLog:
    frames: list[CanFrame] = []
    errors = 0
    for number, message in enumerate(messages):
        if not math.isfinite(message.timestamp):
            raise RecordingError(f"{path}: frame {number} has no time")
        data, extended, remote = bytes(message.data), message.is_extended_id, message.is_remote_frame
        fd = message.is_fd if fd_is_said else len(data) > _CLASSIC_BYTES
        if message.is_error_frame:
            errors += 1
        else:
            bus = "can" if message.channel is None else f"can{message.channel}"
            frames.append(CanFrame(message.timestamp, bus, message.arbitration_id, extended, remote, data, fd))
    return CanLog(frames, [counted(errors, "error frame")] if errors else [])
