"""Whether files can be written where they shall be, asked before the work is done and not after it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hil.errors import UnusableInputError


def not_an_input(out: Path, *inputs: Path) -> None:
    """Refuse to write over an input.

    Raises
    ------
    UnusableInputError
        `out` is one of the inputs.
    """
    for path in inputs:
        if out.exists() and path.exists() and out.samefile(path):
            raise UnusableInputError(f"{out}: is read by this command; write to another file")


def can_be_written(*paths: Path | None, suffixes: tuple[str, ...] = ()) -> None:
    """Refuse a place that cannot be written to before the work is done, not after.

    Raises
    ------
    UnusableInputError
        The folder does not exist or cannot be written to, the path is a folder, or its suffix is none of `suffixes`.
    """
    for path in paths:
        if path is None:
            continue
        refuse_unwritable(path, str(path))
        if suffixes and path.suffix.lower() not in suffixes:
            raise UnusableInputError(f"{path}: must end in {', '.join(suffixes)}")


def folder_can_be_written(folder: Path) -> None:
    """Refuse a folder that cannot be written to; it is made when there is something to put into it.

    Raises
    ------
    UnusableInputError
        It is a file or lies in one, or cannot be written to.
    """
    nearest = next(there for there in (folder.absolute(), *folder.absolute().parents) if there.exists())
    if not nearest.is_dir():
        raise UnusableInputError(f"{folder if nearest == folder.absolute() else nearest}: is a file; give a folder for the answer")
    refuse_unwritable_folder(nearest, str(folder))


def refuse_unwritable(file: Path, named: str) -> None:
    """Refuse a file that cannot be written, before the work is done and not after it.

    Nothing is written. Where there is no such file yet, an unnamed temporary file is made in its folder and removed at once, since
    permissions and mount options alone do not show everything that may prevent writing. A device or a pipe is left alone.

    Raises
    ------
    UnusableInputError
        `named` and what is wrong.
    """
    folder = file.absolute().parent
    if not folder.is_dir():
        raise UnusableInputError(f"{named}: there is no folder {file.parent}; make it first")
    if file.is_dir():
        raise UnusableInputError(f"{named}: is a folder; give a file in it")
    try:
        if file.is_file():
            file.open("ab").close()
        elif not file.exists():
            refuse_unwritable_folder(folder, named)
    except OSError as error:
        raise UnusableInputError(f"{named}: cannot be written: {error.strerror}; give another place") from None


def refuse_unwritable_folder(folder: Path, named: str) -> None:
    """Refuse an existing folder that cannot be written to.

    Raises
    ------
    UnusableInputError
        `named` and what is wrong.
    """
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise UnusableInputError(f"{named}: cannot be written to: {error.strerror}; give another place") from None
