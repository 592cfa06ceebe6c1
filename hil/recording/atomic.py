"""Files that are either whole or not there."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from hil.errors import RecordingError


def write_atomically(path: Path, content: bytes) -> None:
    """Write `content` beside `path`, bring it to the disk, then let it take `path`'s place.

    Raises
    ------
    RecordingError
        The file cannot be written (no such folder, no permission, disk full); what was at `path` is untouched.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with draft.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except OSError as problem:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise RecordingError(f"{path}: cannot be written: {problem.strerror or problem}") from None
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Bring the new name to the disk as well, where folders can be synced (not on Windows)."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
