"""A note of the bench that runs on a bus, for processes of the same user that watch it: where its I/O's state is published.

Written and removed outside of any tick. The watcher reads memory that the poller writes anyway.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from hil.bench.asking import stop_socket
from hil.errors import RecordingError, UnusableInputError
from hil.files.atomic import write_atomically
from hil.processes.private_folder import check_own

MOST_BYTES = 1_000


@contextlib.contextmanager
def noticed(bus_url: str, io_memory: str) -> Iterator[None]:
    """Leave the note for the length of the block; a folder that takes none costs the watcher only.

    Parameters
    ----------
    bus_url : str
    io_memory : str
        Name of the shared memory in which the poller publishes the I/O's state.
    """
    path = _path(bus_url, make=True)
    with contextlib.suppress(OSError, RecordingError):
        write_atomically({path: json.dumps({"pid": os.getpid(), "io_memory": io_memory}).encode()})
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def io_memory_of(bus_url: str) -> str:
    """Return the name of the I/O's shared memory of the bench on a bus, "" where none runs."""
    path = _path(bus_url)
    try:
        check_own(path, path.lstat(), stat.S_ISREG)
        note = json.loads(path.read_bytes()[:MOST_BYTES])
        os.kill(note["pid"], 0)
        return str(note["io_memory"])
    except (OSError, ValueError, KeyError, TypeError, UnusableInputError):
        return ""


def _path(bus_url: str, *, make: bool = False) -> Path:
    return stop_socket(bus_url, make=make).with_suffix(".bench.json")
