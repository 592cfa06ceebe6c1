"""Files that a process holds for as long as it lives, so that others know that it does: the system lets go of them whatever ends it."""

from __future__ import annotations

import contextlib
from typing import IO

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def hold(descriptor: int) -> None:
    """Hold an open file until it is closed, where the file system can."""
    if fcntl is not None:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)


def is_held(file: IO[bytes]) -> bool:
    """Return whether somebody holds a file; where that cannot be found out, assume so."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    fcntl.flock(file, fcntl.LOCK_UN)
    return False
