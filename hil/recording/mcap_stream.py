"""The records of an MCAP file, one after the other, in bounded memory: a chunk is unpacked only when it says its size and that is small."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from hil.errors import RecordingError
from hil.extras import extra_package
from hil.files.regular import check_regular

MOST_UNPACKED = 2**28
"""Bytes of one chunk: writers make chunks of some megabytes."""

WHAT = "MCAP files and ROS 2 bags"


def mcap_package(name: str) -> ModuleType:
    """Import a module of the package mcap; UnusableInputError names the extra where it is missing."""
    return extra_package(name, WHAT)


def mcap_records(path: Path) -> Iterator[Any]:
    """Yield the records of a file, those in chunks too.

    Raises
    ------
    RecordingError
        The file is no MCAP file, is damaged or cut off, or a chunk claims more than `MOST_UNPACKED` bytes.
    UnusableInputError
        mcap is not installed.
    """
    reading, opcodes = mcap_package("mcap.stream_reader"), mcap_package("mcap.records")
    failures = mcap_package("mcap.exceptions")
    lz4, zstandard = reading.lz4, reading.zstandard
    check_regular(path, RecordingError)
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            for record in reading.StreamReader(file, emit_chunks=True, record_size_limit=size).records:
                if not isinstance(record, opcodes.Chunk):
                    yield record
                    continue
                claimed = record.uncompressed_size
                if record.compression == "zstd":
                    claimed = max(claimed, zstandard.frame_content_size(record.data))
                elif record.compression == "lz4":
                    claimed = max(claimed, lz4.get_frame_info(record.data)["content_size"])
                if claimed > MOST_UNPACKED:
                    packed = len(record.data)
                    raise RecordingError(f"{path}: a chunk of {packed} bytes claims {claimed}; a chunk has at most {MOST_UNPACKED}")
                yield from reading.breakup_chunk(record, validate_crc=True)
    except RecordingError:
        raise
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror or problem}") from None
    except (failures.EndOfFile, failures.RecordLengthLimitExceeded):
        raise RecordingError(f"{path}: damaged: it was cut off; `mcap recover` makes a whole file of what is there") from None
    except Exception as problem:  # mcap raises any error of its parser
        raise RecordingError(f"{path}: no MCAP file, or damaged: {str(problem).partition(chr(10))[0] or type(problem).__name__}") from None
