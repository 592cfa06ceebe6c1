"""Recordings of a machine wherever they lie: listed, dated by their path, and known by the hash of what is in them."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

from hil.errors import UnusableInputError
from hil.extras import extra_package
from hil.files.atomic import write_atomically
from hil.recording.formats import READABLE

HASHES = "hashes"
"""Folder of a store: hashes of files by what their storage says of them, so that a rerun reads none of them."""

SCAN = "scan.toml"
"""File by which a folder is one of images."""

HASHED_AT_ONCE = 8
"""Files that are read at once to be hashed: enough to hide the latency of object storage."""

_DATE = re.compile(r"(?<!\d)(\d{4})-?(\d{2})-?(\d{2})(?:[T_ ](\d{2})[-:]?(\d{2})(?:[-:]?(\d{2}))?Z?)?(?!\d)")
_CHANGED = ("mtime", "LastModified", "last_modified", "ETag", "etag", "updated", "md5Hash", "content_md5")
"""What storages call the time of a file's last change or the fingerprint of what is in it."""


@dataclass(frozen=True)
class StoredFile:
    """A file of a recording.

    Attributes
    ----------
    url : where it is read.
    name : its path under the machine's recordings.
    sha256 : of what is in it.
    """

    url: str
    name: str
    sha256: str


@dataclass(frozen=True)
class StoredRecording:
    """A recording: its file, for CSV the metadata beside it, and its images, where there is a folder of its name."""

    file: StoredFile
    night: datetime
    beside: StoredFile | None = None
    images: tuple[StoredFile, ...] = ()

    @property
    def stem(self) -> str:
        """Name without folder and suffix."""
        return PurePosixPath(self.file.name).stem

    @property
    def undated(self) -> str:
        """The same without the date."""
        return _DATE.sub("", self.stem).strip("-_. ") or self.stem

    @property
    def hashes(self) -> tuple[str, ...]:
        """Hashes of all that is read."""
        return tuple(one.sha256 for one in (self.file, self.beside, *self.images) if one is not None)

    def document(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"files": [asdict(one) for one in (self.file, self.beside, *self.images) if one is not None], "scan": self._scan}

    @property
    def _scan(self) -> str | None:
        """Folder of its images; None where it has none."""
        return str(PurePosixPath(self.file.name).with_suffix("")) if self.images else None


class KnownHashes:
    """Hashes of files that a store has seen, by storage's word of them; kept in a file of its own by each run that adds some."""

    def __init__(self, store: Path) -> None:
        self._folder = store / HASHES
        self._known: dict[str, str] = {}
        self._new: dict[str, str] = {}
        for path in sorted(self._folder.glob("*.json")):
            self._known |= json.loads(path.read_text(encoding="utf-8"))

    def of(self, files: list[tuple[Any, str, str]]) -> list[str]:
        """Return the hash of each (file system, path, key), reading those that are not known; the key "" is never known."""
        unknown = [place for place, (_, _, key) in enumerate(files) if key not in self._known]
        with ThreadPoolExecutor(HASHED_AT_ONCE) as pool:
            found = dict(zip(unknown, pool.map(lambda place: sha256_of(*files[place][:2]), unknown), strict=True))
        for place, sha256 in found.items():
            if key := files[place][2]:
                self._known[key] = self._new[key] = sha256
        return [found.get(place) or self._known[key] for place, (_, _, key) in enumerate(files)]

    def keep(self) -> None:
        """Write what is new; RecordingError where that cannot be."""
        if not self._new:
            return
        content = json.dumps(self._new, sort_keys=True).encode("utf-8")
        self._folder.mkdir(parents=True, exist_ok=True)
        write_atomically({self._folder / f"{hashlib.sha256(content).hexdigest()[:32]}.json": content})
        self._new = {}


def list_recordings(url: str, known: KnownHashes, images: bool = False) -> tuple[list[StoredRecording], list[str]]:
    """Return the recordings under a URL, with images if wanted, and a line for each without a date and for images of no recording.

    Raises
    ------
    UnusableInputError
        There is no such place, or what reads its storage is not installed.
    """
    system, listed = _listed(url)
    inside = {name: info for name, info in listed.items() if not any(part.startswith(".") for part in PurePosixPath(name).parts)}
    scans = {str(PurePosixPath(name).parent) for name in inside if PurePosixPath(name).name == SCAN}
    wanted: dict[str, tuple[datetime, list[str], list[str]]] = {}
    wrong = []
    alone = set(scans) if images else set()
    for name in sorted(inside):
        path = PurePosixPath(name)
        if path.suffix.lower() not in READABLE or str(path.parent) in scans:
            continue
        if (night := night_of(name)) is None:
            wrong.append(f"{url}: {name}: its path has no date; 2026-11-27/{path.name} would be right")
            continue
        beside = [str(path.with_suffix(".toml"))] if path.suffix.lower() == ".csv" else []
        scan = str(path.with_suffix(""))
        alone.discard(scan)
        shown = sorted(one for one in inside if str(PurePosixPath(one).parent) == scan) if images and scan in scans else []
        wanted[name] = (night, [one for one in beside if one in inside], shown)
    wrong += [f"{url}: {scan}: images of no recording; {scan}.mf4 beside them would be right" for scan in sorted(alone)]
    names = list(dict.fromkeys(one for name, (_, beside, shown) in wanted.items() for one in (name, *beside, *shown)))
    hashes = known.of([(system, inside[name]["name"], _key(url, inside[name])) for name in names])
    stored = {
        name: StoredFile(system.unstrip_protocol(inside[name]["name"]), name, sha256) for name, sha256 in zip(names, hashes, strict=True)
    }
    found = [
        StoredRecording(stored[name], night, stored[beside[0]] if beside else None, tuple(stored[one] for one in shown))
        for name, (night, beside, shown) in wanted.items()
    ]
    return found, wrong


def night_of(name: str) -> datetime | None:
    """Return the first date in a path, with its time of day where that follows, in UTC; None without one."""
    for found in _DATE.finditer(name):
        try:
            return datetime(*(int(part or 0) for part in found.groups()), tzinfo=UTC)  # type: ignore[misc, arg-type]
        except ValueError:  # twenty digits that are no date
            continue
    return None


def sha256_of(system: Any, path: str) -> str:  # noqa: ANN401, fsspec has no types
    """Return the hash of a file."""
    digest = hashlib.sha256()
    with system.open(path, "rb") as file:
        for block in _blocks(file):
            digest.update(block)
    return digest.hexdigest()


def _blocks(file: Any) -> Iterator[bytes]:  # noqa: ANN401
    while block := file.read(1 << 20):
        yield block


def _listed(url: str) -> tuple[Any, dict[str, dict[str, Any]]]:
    """Return the file system, and what is in the folder by its path from there."""
    fsspec = extra_package("fsspec", "recordings of a fleet")
    try:
        system, path = fsspec.core.url_to_fs(url)
        if is_pattern := any(sign in path for sign in "*?["):
            found = system.glob(path, detail=True)
            base = _base(path)
        else:
            found, base = system.find(path, detail=True), path.rstrip("/")
        if not found and not is_pattern and not system.exists(path):
            raise UnusableInputError(f"{url}: there is no such folder; give the folder of a machine's recordings")
    except UnusableInputError:
        raise
    except ImportError as problem:
        raise UnusableInputError(f"{url}: {' '.join(str(problem).split())}") from None
    except Exception as problem:  # each storage has its own
        raise UnusableInputError(f"{url}: cannot be listed: {' '.join(str(problem).split()) or type(problem).__name__}") from None
    infos = [info for info in found.values() if info.get("type") != "directory"]
    return system, {info["name"].removeprefix(base).lstrip("/"): info for info in infos}


def _base(pattern: str) -> str:
    """Return the folder from which names of a pattern count: above the first part with a wildcard or a date."""
    parts = pattern.split("/")
    first = next(place for place, part in enumerate(parts) if any(sign in part for sign in "*?[") or night_of(part) is not None)
    return "/".join(parts[:first])


def _key(url: str, info: dict[str, Any]) -> str:
    """Return what a storage says of a file as one text, "" where it does not say when the file was changed."""
    said = {key: str(info[key]) for key in ("ino", "created", *_CHANGED) if info.get(key) is not None}
    if not any(key in said for key in _CHANGED):
        return ""
    return json.dumps([url.partition("://")[0] if "://" in url else "file", info["name"], info.get("size"), said], sort_keys=True)
