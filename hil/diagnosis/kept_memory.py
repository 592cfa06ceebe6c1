"""Memory that free runs give back stays with the process, for the next one to take.

A run of a minute takes and gives back thirty arrays of one to twenty megabytes. The C library would hand each of them back to the kernel,
which clears every page anew when it is touched again: a twelfth of a diagnosis' processor time, and meanwhile other threads wait.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3
"""Of glibc's `mallopt`: free bytes at a heap's end from which it shrinks, what is left of them there, and sizes from which an array has
memory of its own."""

KEPT = {TRIM_THRESHOLD: 1 << 30, TOP_PAD: 1 << 26, MMAP_THRESHOLD: 1 << 30}
"""In bytes. A thread's heaps are 64 MB each: with as much left, one that is empty stays."""


def keep_memory() -> None:
    """From now on. Nothing happens where the C library is another one."""
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for what, size in KEPT.items():
            mallopt(what, size)
