"""A ring of rows in memory that two processes share: the loop writes, the recorder reads, without locks and waits.

The memory has no name: the recorder inherits it, so it is freed when both have ended, however they end. (On Windows, where it cannot be
inherited, it has a name, and is freed likewise.) Counters only grow and each has one writer. A row is written before `produced` counts it;
`consumed` moves only once the row is in the journal, so that a recorder that dies leaves its successor everything.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import secrets
import sys
import tempfile

import numpy as np

_COUNTER_STRIDE = 8  # counters of different writers are a cache line of 64 bytes apart
_HEADER_BYTES = 512

PRODUCED = 0 * _COUNTER_STRIDE
"""Counter of rows written by the loop."""
CONSUMED = 1 * _COUNTER_STRIDE
"""Counter of rows that the recorder has moved into the journal."""
LOST = 2 * _COUNTER_STRIDE
"""Counter of rows that the loop could not write because the ring was full."""
RECORDER = 3 * _COUNTER_STRIDE
"""Process id of the recorder."""
BEAT = 4 * _COUNTER_STRIDE
"""Counter of the recorder's rounds: it stands still when the recorder does."""


class Ring:
    """Rows of `width` float64 in shared memory.

    Parameters
    ----------
    width, capacity : int
        Number of columns and of rows.
    key : str, optional
        The `key` of the ring to attach to, in a process that inherited its memory; None makes a new one.
    """

    def __init__(self, width: int, capacity: int, key: str | None = None) -> None:
        self.width = width
        self.capacity = capacity
        size = _HEADER_BYTES + capacity * width * 8
        self.key, self._memory, self._handle = _map(size, key)
        self.counters = memoryview(self._memory)[:_HEADER_BYTES].cast("q")
        self.rows = np.frombuffer(self._memory, dtype=np.float64, offset=_HEADER_BYTES).reshape(capacity, width)
        if key is None:
            self.rows[:] = 0.0  # touches every page, so that the loop has no page faults later

    @property
    def inherited(self) -> tuple[int, ...]:
        """File descriptors that a child process must inherit."""
        return () if self._handle < 0 else (self._handle,)

    def take(self, first: int, limit: int) -> np.ndarray:
        """Copy rows `first`, `first + 1`, ... (at most `limit`, at most those available, at most to the end of the memory)."""
        slot = first % self.capacity
        count = min(self.counters[PRODUCED] - first, limit, self.capacity - slot)
        return self.rows[slot : slot + max(count, 0)].copy()

    def close(self) -> None:
        """Release the memory."""
        self.counters.release()
        del self.rows
        with contextlib.suppress(BufferError):
            self._memory.close()
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def _map(size: int, key: str | None) -> tuple[str, mmap.mmap, int]:
    """Return key, mapped memory and file descriptor (-1 where there is none)."""
    if sys.platform == "win32":
        key = key or f"isocenter-ring-{os.getpid()}-{secrets.token_hex(8)}"
        return key, mmap.mmap(-1, size, tagname=key), -1
    if key is not None:
        handle = int(key)
        return key, mmap.mmap(handle, size), handle
    if sys.platform == "linux":
        handle = os.memfd_create("isocenter-ring")
    else:
        handle, name = tempfile.mkstemp()
        os.unlink(name)
    os.ftruncate(handle, size)
    return str(handle), mmap.mmap(handle, size), handle
