"""What is given as a file is one, and of a size that fits into memory."""

from __future__ import annotations

import stat
from pathlib import Path

from hil.errors import UnusableInputError

MOST_BYTES = 2**31
"""The largest file that is read into memory: six hours of forty channels at 256 Hz, uncompressed."""


def check_regular(path: Path, error: type[UnusableInputError] = UnusableInputError, most_bytes: float = MOST_BYTES) -> None:
    """Raise `error` for a device, pipe or socket, which would be read without end, and for a file that fills the memory.

    `most_bytes` is infinite for a file that is read piece by piece.

    A folder, or a path that cannot be looked at, raises nothing: whoever opens it says why.
    """
    try:
        status = path.stat()
    except (OSError, ValueError):  # ValueError: a path with a null byte
        return
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise error(f"{path}: is a device, pipe or socket and no regular file; copy what is in it to a file, and give that")
    if status.st_size > most_bytes:
        raise error(f"{path}: {status.st_size} bytes; at most {most_bytes} are read into memory; give a part of it")
