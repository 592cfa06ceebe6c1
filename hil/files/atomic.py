"""Files that are either whole or not there."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hil.errors import RecordingError

FLUSHED_AT_ONCE = 16
"""Files that are flushed together: a file system with a journal commits them as one, in the time of one."""


def write_atomically(files: Mapping[Path, bytes]) -> None:
    """Write every file under a temporary name, flush all to the disk, then rename each into place.

    Raises
    ------
    RecordingError
        A file cannot be written (no such folder, no permission, disk full); existing files are untouched.
    """
    own = f"{os.getpid()}.{secrets.token_hex(4)}"  # several hosts may write the same file, each with its own process of this number
    drafts = {path: path.with_name(f".{path.name}.{own}.tmp") for path in files}
    at = next(iter(files))
    try:
        with ThreadPoolExecutor(min(len(files), FLUSHED_AT_ONCE)) as pool:
            written = {path: pool.submit(_write, drafts[path], content) for path, content in files.items()}
        for at, each in written.items():  # noqa: B007, it names the file that failed
            each.result()
        for at, draft in drafts.items():
            os.replace(draft, at)
    except BaseException as problem:
        for draft in drafts.values():
            with contextlib.suppress(OSError):
                draft.unlink()
        if not isinstance(problem, OSError):
            raise
        raise RecordingError(f"{at}: cannot be written: {problem.strerror or problem}") from None
    for folder in dict.fromkeys(path.parent for path in files):
        _sync_folder(folder)


def _write(draft: Path, content: bytes) -> None:
    with draft.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Flush the new names to the disk as well, where folders can be synced (not on Windows)."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
