"""The newest estimate, readable by another process while the loop runs: a page of shared memory, one writer, any number of readers.

A counter is odd while the writer writes and even when it is done, so that a reader knows whether its copy is of one row; nobody waits, and
the loop copies some hundred numbers per tick. The writer holds a lock on its page's file for as long as it lives. Where the lock is free
there is no writer, however it ended, even if another process has its process number.

    newest = latest_estimate("socketcan:vcan0")
    newest.row, newest["estimate_detector_x"], newest["estimate_detector_x_variance"]
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import mmap
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.errors import UnusableInputError
from hil.files.held import hold, is_held

_COUNTERS = 3
"""Sequence, row, bytes of the names."""

_SEQUENCE, _ROW, _NAMES = range(_COUNTERS)
_ATTEMPTS = 1000
"""Copies a reader makes before it gives up: the writer takes microseconds out of milliseconds, so the second succeeds."""

FRESH_S = 60.0
"""A page that is not yet in its place and younger than this may be one that is just being made."""


@dataclass(frozen=True)
class LatestEstimate:
    """Row number of the recording, and the values (channels,) of that row under their names."""

    row: int
    names: tuple[str, ...]
    values: np.ndarray

    def __getitem__(self, name: str) -> float:
        """Return one value."""
        try:
            return float(self.values[self.names.index(name)])
        except ValueError:
            raise UnusableInputError(f"no estimate {name}; there is {', '.join(self.names)}") from None


class EstimateBoard:
    """The writer's end: opened once the bus belongs to the writer, closed after the runs.

    A page is a file of its own and replaces an earlier one as a whole: processes that still write or read the earlier one are not
    disturbed.

    Parameters
    ----------
    bus_url : str
        Of the machine, under which readers find it.
    names : sequence of str
        Of the values.
    """

    def __init__(self, bus_url: str, names: Sequence[str]) -> None:
        text = json.dumps(list(names)).encode()
        first = 8 * _COUNTERS + -(-len(text) // 8) * 8
        self._path = _path(bus_url)
        handle, made = tempfile.mkstemp(prefix=f"{self._path.name}.", dir=self._path.parent)
        try:
            hold(handle)
            os.ftruncate(handle, first + 8 * len(names))
            self._memory = mmap.mmap(handle, first + 8 * len(names))
        except BaseException:
            os.close(handle)
            os.unlink(made)
            raise
        self._handle = handle
        self._memory[8 * _COUNTERS : 8 * _COUNTERS + len(text)] = text
        self._counters = np.frombuffer(self._memory, dtype=np.int64, count=_COUNTERS)
        self._values = np.frombuffer(self._memory, dtype=np.float64, offset=first)
        self._counters[:] = 0, -1, len(text)
        self._values[:] = np.nan
        os.replace(made, self._path)

    def put(self, row: int, values: np.ndarray) -> None:
        """Publish a row's values (channels,)."""
        counters = self._counters
        counters[_SEQUENCE] += 1
        counters[_ROW] = row
        self._values[:] = values
        counters[_SEQUENCE] += 1

    def close(self) -> None:
        """Remove the page; a page that has replaced it stays."""
        with contextlib.suppress(OSError):
            _remove(self._path, os.fstat(self._handle).st_ino)
        os.close(self._handle)


def latest_estimate(bus_url: str) -> LatestEstimate:
    """Return the newest estimate of the observer that runs on a bus.

    Raises
    ------
    UnusableInputError
        No observer runs there.
    """
    path = _path(bus_url)
    try:
        with path.open("rb") as file:
            memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            is_written = is_held(file)
    except (OSError, ValueError):
        raise UnusableInputError(f"{bus_url}: no observer runs there; `isocenter run ... --observer FILE` starts one") from None
    with memory:
        # copies throughout: nothing may hold on to the memory when it is closed
        for _ in range(_ATTEMPTS):
            before, row, size = (int(value) for value in np.frombuffer(memory[: 8 * _COUNTERS], dtype=np.int64))
            first = 8 * _COUNTERS + -(-size // 8) * 8
            names = memory[8 * _COUNTERS : 8 * _COUNTERS + size]
            values = np.frombuffer(memory[first:], dtype=np.float64)
            after = int(np.frombuffer(memory[:8], dtype=np.int64)[0])
            if before == after and not before % 2:
                break
        else:
            raise UnusableInputError(f"{bus_url}: the observer there stopped in the middle of a row")
    if not is_written:
        raise UnusableInputError(f"{bus_url}: the observer that ran there has ended")
    return LatestEstimate(row, tuple(json.loads(names)), values)


def remove_abandoned() -> int:
    """Remove this user's pages whose writers were killed, and return how many there were."""
    base, prefix = _place()
    removed = 0
    for path in base.glob(f"{prefix}*.estimate*"):
        with contextlib.suppress(OSError), path.open("rb") as file:
            page = os.fstat(file.fileno())
            is_in_place = path.suffix == ".estimate"
            if not is_held(file) and (is_in_place or time.time() - page.st_mtime > FRESH_S):
                removed += _remove(path, page.st_ino)
    return removed


def _remove(path: Path, inode: int) -> bool:
    """Remove a page unless another has replaced it; one that does so at this moment is put back."""
    if path.stat().st_ino != inode:
        return False
    aside = path.with_name(f"{path.name}.{os.getpid()}.old")
    path.rename(aside)
    is_it = aside.stat().st_ino == inode
    if not is_it:
        with contextlib.suppress(FileExistsError):  # a third has come meanwhile
            os.link(aside, path)
    aside.unlink()
    return is_it


def _path(bus_url: str) -> Path:
    base, prefix = _place()
    return base / f"{prefix}{hashlib.sha256(bus_url.encode()).hexdigest()[:16]}.estimate"


def _place() -> tuple[Path, str]:
    """Return the folder of this user's pages, and what their names begin with."""
    shared = Path("/dev/shm")  # memory where the system has it as files
    base = shared if shared.is_dir() else Path(tempfile.gettempdir())
    user = os.getuid() if hasattr(os, "getuid") else "user"
    return base, f"isocenter-{user}-"
