"""A folder that only its user can enter, for what processes of this host tell each other."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path

from hil.errors import UnusableInputError

FOLDER_MODE = 0o700
REMEDY = "set XDG_RUNTIME_DIR to a folder of your own"
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def private_folder() -> Path:
    """Return the folder, which may not be there yet."""
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"isocenter-{os.getuid() if hasattr(os, 'getuid') else 'user'}"


def made_private_folder() -> Path:
    """Make the folder where it is not there, and return it.

    Raises
    ------
    UnusableInputError
        It is not this user's own.
    OSError
        It cannot be made.
    """
    folder = private_folder()
    folder.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)
    check_own(folder, folder.lstat(), stat.S_ISDIR)
    return folder


def check_own(path: Path, status: os.stat_result, is_kind: Callable[[int], bool]) -> None:
    """Refuse a folder or file that somebody else may have made, or may change.

    Raises
    ------
    UnusableInputError
        It is another user's, a link, or can be written by others.
    """
    if not hasattr(os, "getuid"):
        return  # Windows: the user's temporary folder is closed to others
    if stat.S_ISLNK(status.st_mode) or not is_kind(status.st_mode):
        wrong = "is a link or no folder" if is_kind is stat.S_ISDIR else "is a link or no file"
    elif status.st_uid != os.getuid():
        wrong = f"belongs to user {status.st_uid}, not to you ({os.getuid()})"
    elif status.st_mode & _WRITABLE_BY_OTHERS:
        wrong = f"can be written by others (mode {stat.S_IMODE(status.st_mode):o})"
    else:
        return
    raise UnusableInputError(f"{path}: {wrong}, so what it says is not believed; remove it, or {REMEDY}")
