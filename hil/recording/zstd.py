"""What `ros2 bag record --compression-format zstd` packs: whole files of a bag, or its messages one by one."""

from __future__ import annotations

from pathlib import Path

from hil.errors import RecordingError
from hil.files.regular import MOST_BYTES, check_regular
from hil.recording.mcap_stream import MOST_UNPACKED, mcap_package

ZSTD_MARK = b"\x28\xb5\x2f\xfd"
"""First bytes of a frame of Zstandard (RFC 8878, 3.1.1)."""

PACKED = ".zstd"
_PIECE = 2**20


def unpacked_file(path: Path, folder: Path) -> Path:
    """Unpack a file of a bag into a folder; return where it is.

    Raises
    ------
    RecordingError
        The file is damaged, or unpacks to more than `MOST_BYTES`.
    UnusableInputError
        mcap, which brings zstandard, is not installed.
    """
    zstandard = mcap_package("mcap.stream_reader").zstandard
    check_regular(path, RecordingError)
    target = folder / path.stem
    total = 0
    try:
        with path.open("rb") as source, target.open("wb") as out, zstandard.ZstdDecompressor().stream_reader(source) as pieces:
            while piece := pieces.read(_PIECE):
                total += len(piece)
                if total > MOST_BYTES:
                    raise RecordingError(f"{path}: unpacks to more than {MOST_BYTES} bytes; give a part of it")
                out.write(piece)
        if not total:
            raise RecordingError(f"{path}: damaged: there is nothing in it")
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be unpacked: {problem.strerror}") from None
    except zstandard.ZstdError as problem:
        raise RecordingError(f"{path}: damaged: {problem}") from None
    return target


def unpacked_message(data: bytes, path: Path) -> bytes:
    """Return one message of a bag, unpacked; errors as in `unpacked_file`."""
    zstandard = mcap_package("mcap.stream_reader").zstandard
    try:
        claimed = zstandard.frame_content_size(data)
        if claimed > MOST_UNPACKED:
            raise RecordingError(f"{path}: a message of {len(data)} bytes claims {claimed}; it has at most {MOST_UNPACKED}")
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=MOST_UNPACKED if claimed < 0 else 0))
    except zstandard.ZstdError as problem:
        raise RecordingError(f"{path}: damaged: {problem}") from None
