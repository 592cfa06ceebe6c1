"""Memory that free runs give back stays with the process, for the next one to take.

A run of a minute takes and gives back thirty arrays of one to twenty megabytes. The C library would hand each of them back to the kernel,
which clears every page anew when it is touched again: a twelfth of a diagnosis' processor time, and meanwhile other threads wait.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Of glibc's `mallopt`: free bytes at the heap's end from which it shrinks, and sizes from which an array has memory of its own. That heaps
of threads stay when they are empty (M_TOP_PAD) brings half a second more and costs 0.16 GB."""

LARGEST_KEPT_BYTES = 1 << 30


def keep_memory() -> None:
    """From now on. Nothing happens where the C library is another one."""
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for threshold in (TRIM_THRESHOLD, MMAP_THRESHOLD):
            mallopt(threshold, LARGEST_KEPT_BYTES)
