"""The folder of the bench: recordings, and pages and pictures that were made of them."""

from __future__ import annotations

import json
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
        self._told: dict[Path, tuple[int, dict[str, str]]] = {}  # by answer, of which writing, what experiments its recordings are of

    def entries(self) -> list[dict[str, Any]]:
        """Return name, kind, size and time of each file, the newest first; of a recording the experiment, where a run has told it."""
        found: list[dict[str, Any]] = []
        experiments = self._experiments()
        for path in (*self._folder.glob("*"), *self._folder.glob("*/*")):
            if path.suffix in SHOWN and path.is_file() and not path.name.startswith("."):
                status = path.stat()
                kind = "recording" if path.suffix in RECORDINGS else path.suffix[1:]
                name = path.relative_to(self._folder).as_posix()
                entry = {"name": name, "kind": kind, "bytes": status.st_size, "time_s": status.st_mtime}
                if kind == "recording":
                    entry["experiment"] = experiments.get(path.name, "")
                found.append(entry)
        return sorted(found, key=lambda entry: entry["time_s"], reverse=True)[:MOST]

    def _experiments(self) -> dict[str, str]:
        """Return the kind of experiment of each recording that the answers in the folder, `NAME.json`, tell of."""
        for path in self._folder.glob("*.json"):
            written = path.stat().st_mtime_ns
            if self._told.get(path, (0, {}))[0] != written:
                try:
                    answer = json.loads(path.read_text(encoding="utf-8"))
                    told = {Path(each["recording"]).name: str(each["experiment"]["kind"]) for each in answer["recordings"]}
                except (OSError, ValueError, KeyError, TypeError):
                    told = {}
                self._told[path] = written, told
        return {name: kind for _, told in self._told.values() for name, kind in told.items()}

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
