"""The folder of the bench: recordings, and pages and pictures that were made of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil.errors import UnusableInputError

RECORDINGS = (".mf4", ".csv", ".parquet", ".mcap")
SHOWN = (".html", ".png", ".json", ".toml", *RECORDINGS, ".npz", ".jsonl")
MOST = 500


class Listing:
    """What may be seen of a folder: files of known kinds, in it or one folder below, no links out of it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def entries(self) -> list[dict[str, Any]]:
        """Return name, kind, size and time of each file, the newest first."""
        found: list[dict[str, Any]] = []
        for path in (*self._folder.glob("*"), *self._folder.glob("*/*")):
            if path.suffix in SHOWN and path.is_file() and not path.name.startswith("."):
                status = path.stat()
                kind = "recording" if path.suffix in RECORDINGS else path.suffix[1:]
                name = path.relative_to(self._folder).as_posix()
                found.append({"name": name, "kind": kind, "bytes": status.st_size, "time_s": status.st_mtime})
        return sorted(found, key=lambda entry: entry["time_s"], reverse=True)[:MOST]

    def path(self, name: object) -> Path:
        """Return the path of a file.

        Raises
        ------
        UnusableInputError
            There is none of this name in the folder.
        """
        path = (self._folder / str(name)).resolve() if isinstance(name, str) and "\0" not in name else self._folder
        if not path.is_relative_to(self._folder) or path.suffix not in SHOWN or not path.is_file() or path.name.startswith("."):
            raise UnusableInputError(f"{str(name)[:80]}: no such file in the bench's folder")
        return path

    def recordings(self, names: object) -> list[Path]:
        """Return the paths of some recordings; raises as `path`."""
        if not isinstance(names, Sequence) or isinstance(names, str):
            raise UnusableInputError("choose recordings first")
        paths = [self.path(name) for name in names]
        for path in paths:
            if path.suffix not in RECORDINGS:
                raise UnusableInputError(f"{path.name}: is no recording")
        return paths
