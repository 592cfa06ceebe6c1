"""MDF 4 recordings (`.mf4`): ordinary signals with units that asammdf and vendors' tools can open, metadata as an attached TOML text.

A missing sample has its invalidation bit set (and is NaN or 0 below it, for tools that ignore the bit). Counters and bit fields are
integers.

MDF has no checksum, and asammdf reacts to a damaged file with anything from a wrong number to an attempt to allocate a petabyte. So a file
written here ends with 16 bytes that no block refers to and other readers ignore: `isocrc32`, the CRC-32 of everything before as u32, and
the number of those bytes as u32 modulo 2^32, little endian. A tool that edits the file drops them, and then nothing is checked.

The same recording gives the same file, byte for byte: times of day come only from metadata `started`.
"""

from __future__ import annotations

import contextlib
import gc
import io
import logging
import re
import struct
import sys
import tempfile
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import can  # noqa: F401  # isort: skip  # before asammdf: python-can meets it half imported otherwise, and takes it for missing
import numpy as np
from asammdf import MDF, Signal
from asammdf.blocks.v4_blocks import HeaderBlock
from asammdf.blocks.v4_constants import CompressionAlgorithm

from hil.errors import RecordingError
from hil.files.atomic import write_atomically
from hil.files.regular import MOST_BYTES
from hil.recording.can_tables import Group, frames_of_mdf, has_only_frames
from hil.recording.channels import is_whole
from hil.recording.mdf4_columns import mdf4_columns
from hil.recording.metadata import machine_table, metadata_text, parse_metadata
from hil.recording.naming import Columns, Target, named_or_own
from hil.recording.rasters import channels_on_one_raster
from hil.recording.recording import Channel, Recording
from hil.recording.said import source_table

if TYPE_CHECKING:
    from hil.machine.machine import Machine

ATTACHMENT = "recording.toml"
"""Name of the attached metadata."""

MDF_VERSION = "4.10"
"""The oldest version with invalidation bits and compression, which most tools can open."""

_HISTORY = """<FHcomment>
<TX>recorded</TX>
<tool_id>isocenter</tool_id>
<tool_vendor>isocenter</tool_vendor>
<tool_version>1</tool_version>
</FHcomment>"""
_SEAL = struct.Struct("<8sII")
_SEAL_MARK = b"isocrc32"
_IN_MEMORY = re.compile(r"""['"]?<_io\.BytesIO[^>]*>['"]?""")
"""Name that asammdf gives to a file in memory."""

_VIRTUAL = (3, 6)
"""Types of channels of MDF 4 whose values are the numbers of their rows."""

DEFLATE_AT_MOST = 1032
"""Most bytes that a byte of a compressed block can stand for (zlib's technical details)."""


def write_mdf4(recording: Recording, path: Path) -> None:
    """Write a recording; RecordingError if the file cannot be written or there is nothing but time."""
    if len(recording.channels) < 2 or not recording.rows:
        raise RecordingError(f"{path}: nothing to write: {recording.rows} rows of {', '.join(recording.channels)}")
    signals = [_signal(name, channel, recording.time) for name, channel in recording.channels.items() if name != "time"]
    try:
        content = _mdf_bytes(recording, signals, _started(recording, path))
    except OSError as problem:  # asammdf keeps its data in a temporary file
        raise RecordingError(f"{path}: cannot be written: {problem.strerror} (temporary file in {tempfile.gettempdir()})") from None
    write_atomically({path: _sealed(content)})


def read_mdf4(path: Path, machine: Machine | None = None, names: Mapping[str, Target] | None = None, part: str = "") -> Recording:
    """Read a recording of this project, or any MDF 3 or 4 file; signals of several rasters are put onto one, CAN frames are decoded.

    Parameters
    ----------
    path : Path
    machine : Machine, optional
        Replaces the metadata where none are attached; its rate chooses the raster.
    names : mapping, optional
        Name in the file -> channel. Signals that it does not name keep theirs.
    part : str
        Of samples of several senders those to take, as in `stamps`; of frames as in `can_signals`.

    Raises
    ------
    RecordingError
        The file is no MDF file or damaged, a name stands for several signals, or there are neither metadata nor a machine.
    """
    try:
        content = path.read_bytes()
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None
    _check_seal(content, path)
    reason, log = "", None
    with _hushed():
        try:
            with MDF(io.BytesIO(content)) as mdf:
                _check_claims(mdf, len(content), path)
                log = frames_of_mdf(content, path) if has_only_frames(mdf) and not names else None
                metadata, is_own = ({}, False) if log is not None else _metadata(mdf, path, machine)
                found = Columns({}) if log is not None else mdf4_columns(mdf)
        except RecordingError:
            raise
        except Exception as problem:
            reason = _IN_MEMORY.sub("it", str(problem).strip().partition("\n")[0]) or type(problem).__name__
        if reason:
            gc.collect()  # asammdf's half-built objects raise in their destructors: collect them here
    if reason:
        raise RecordingError(f"{path}: no MDF file, or damaged: {reason}")
    if log is not None:
        from hil.recording.can_signals import recording_of_log

        return recording_of_log(log, path, machine, part)
    try:
        return _recording(found, names, metadata, machine, path, part, is_own)
    except RecordingError as problem:
        raise RecordingError(str(problem) if str(problem).startswith(str(path)) else f"{path}: {problem}") from None


def _recording(
    found: Columns, names: Mapping[str, Target] | None, metadata: dict[str, Any], machine: Machine | None, path: Path, part: str,
    is_own: bool,
) -> Recording:  # fmt: skip
    """Return the signals as channels: under the given names, others under their own."""
    wanted, not_taken = named_or_own(found, names or {}, path, machine)
    channels, notes = channels_on_one_raster(found, wanted, machine, path, part, is_own)
    not_taken += [f"{name}: {what}" for name, what in found.others.items()]
    notes = [*found.notes, *notes]
    if not_taken or notes or names:
        renamed = {name: wanted_as.channel for name, wanted_as in (names or {}).items()}
        metadata = metadata | {"source": source_table(path, not_taken, notes, renamed)}
    return Recording(channels, metadata)


def _check_claims(mdf: MDF, file_bytes: int, path: Path) -> None:
    """Refuse a file whose headers claim more than it can hold, before memory is taken for that or read behind its end."""
    claimed = 0
    for group in cast(Sequence[Group], mdf.groups):
        head = group.channel_group
        row_bytes = head.samples_byte_nr + getattr(head, "invalidation_bytes_nr", 0)  # version 3 has none
        claimed += head.cycles_nr * row_bytes
        for channel in group.channels:
            if getattr(channel, "channel_type", 0) in _VIRTUAL:
                continue
            first_bit = 8 * getattr(channel, "byte_offset", 0) + getattr(channel, "bit_offset", 0) + getattr(channel, "start_offset", 0)
            if first_bit + channel.bit_count > 8 * row_bytes:  # asammdf would read behind the row
                raise RecordingError(f"{path}: damaged: channel {channel.name!r} reaches beyond the {row_bytes} bytes of a row")
    most = min(MOST_BYTES, DEFLATE_AT_MOST * file_bytes)
    if claimed > most:
        raise RecordingError(
            f"{path}: damaged: its headers claim {claimed} bytes of samples; a file of {file_bytes} bytes has at most {most}"
        )


def _signal(name: str, channel: Channel, time: np.ndarray) -> Signal:
    values, missing = channel.values, channel.missing
    present = values[~missing]
    if is_whole(name) and np.all(present == np.rint(present)) and np.all(np.abs(present) < 2.0**53):
        values = np.where(missing, 0.0, values).astype(np.int64)
    return Signal(values, time, unit=channel.unit, name=name, invalidation_bits=missing if missing.any() else None)


def _started(recording: Recording, path: Path) -> datetime:
    """Return when the recording began; the epoch where it does not say, as in virtual time."""
    text = recording.metadata.get("started")
    if text is None:
        return datetime.fromtimestamp(0, UTC)
    try:
        started = datetime.fromisoformat(text)
    except (TypeError, ValueError):
        started = None
    if started is None or started.tzinfo is None:
        raise RecordingError(f"{path}: metadata started = {text!r}: a time with its zone would be right, such as 2025-06-30T12:00:00+00:00")
    return started


def _date(mdf: MDF, started: datetime) -> None:
    """Set this time in header and history, where asammdf would put the time of writing."""
    header = cast(HeaderBlock, mdf.header)
    header.start_time = started
    for entry in mdf.file_history:
        entry.abs_time, entry.time_flags = header.abs_time, header.time_flags
        entry.tz_offset, entry.daylight_save_time = header.tz_offset, header.daylight_save_time
        entry.comment = _HISTORY


def _mdf_bytes(recording: Recording, signals: list[Signal], started: datetime) -> bytes:
    content = io.BytesIO()
    with MDF(version=MDF_VERSION) as mdf:
        mdf.header.comment = f"isocenter recording; machine, experiment and initial states are in the attachment {ATTACHMENT}"
        mdf.append(signals, comment="one row per SYNC", common_timebase=True)
        mdf.attach(metadata_text(recording.metadata).encode(), file_name=ATTACHMENT, comment="metadata of the recording")
        _date(mdf, started)
        mdf.save(content, compression=CompressionAlgorithm.DEFLATE, add_history_block=False)
    return content.getvalue()


def _metadata(mdf: MDF, path: Path, machine: Machine | None) -> tuple[dict[str, Any], bool]:
    """Return the metadata, and whether this project attached them."""
    for attachment in mdf.attachments if mdf.version >= "4" else ():
        if attachment.file_name == ATTACHMENT:
            return parse_metadata(bytes(attachment.extract()).decode(), f"{path}: {ATTACHMENT}"), True
    if machine is None:
        raise RecordingError(f"{path}: no {ATTACHMENT} is attached, so it is no recording of ours; name the machine with --machine")
    return {"machine": machine_table(machine)}, False


def _sealed(content: bytes) -> bytes:
    return content + _SEAL.pack(_SEAL_MARK, zlib.crc32(content), len(content) & 0xFFFFFFFF)


def _check_seal(content: bytes, path: Path) -> None:
    body, seal = content[: -_SEAL.size], content[-_SEAL.size :]
    if seal.startswith(_SEAL_MARK) and seal != _sealed(body)[-_SEAL.size :]:
        raise RecordingError(f"{path}: damaged: its checksum is not that of its content")


@contextlib.contextmanager
def _hushed() -> Iterator[None]:
    """Suppress what asammdf prints, logs and raises in destructors for an unreadable file; one error of this module replaces it."""
    logger, hook = logging.getLogger("asammdf"), sys.unraisablehook
    was_disabled = logger.disabled
    logger.disabled = True
    sys.unraisablehook = lambda _: None
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = was_disabled
        sys.unraisablehook = hook
