"""A folder in which nothing stands that a command would write over."""

from __future__ import annotations

import itertools
from pathlib import Path


def unused_folder(folder: Path) -> Path:
    """Return a folder where it is empty or not there yet; else the first of `NAME-2`, `NAME-3`, ... that is.

    Parameters
    ----------
    folder : Path
        As the user names it. Nothing is made.
    """
    named = folder if folder.name else folder.absolute()  # "." has no name that could be continued
    names = itertools.chain([folder], (named.with_name(f"{named.name}-{n}") for n in itertools.count(2)))
    return next(path for path in names if not path.exists() or (path.is_dir() and not any(path.iterdir())))


def told_of(wanted: Path, taken: Path) -> str:
    """Return the line that says why another folder was taken; "" where none was."""
    return "" if taken == wanted else f"{wanted} holds files already, which stay as they are: all of this goes to {taken}"
