"""Memory that free runs give back stays with the process, for the next one to take.

A run of a minute takes and gives back thirty arrays of one to twenty megabytes. The C library would hand each of them back to the kernel,
which clears every page anew when it is touched again: an eleventh of a diagnosis' processor time, and meanwhile other threads wait.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Of glibc's `mallopt`: free bytes at the heap's end from which it shrinks, and sizes from which an array has memory of its own. That heaps
of threads stay when they are empty (M_TOP_PAD) brings half a second more and costs 0.16 GB."""

LARGEST_KEPT_BYTES = 1 << 30
"""No array of a diagnosis of a minute is as large: the sensitivities of 49 numbers of the C-arm have 70 MB."""

LARGEST_OF_OLDER_BYTES = 32 << 20
"""The largest size that glibc takes where its heaps are of 64 MB: it refuses more than half of one (malloc.c, do_set_mmap_threshold), which
newer ones do not on x86-64."""


def keep_memory() -> None:
    """From now on. Nothing happens where the C library is another one, or takes neither size: set alone, the other threshold would have
    every array mapped anew.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None and any(mallopt(MMAP_THRESHOLD, size) for size in (LARGEST_KEPT_BYTES, LARGEST_OF_OLDER_BYTES)):
        mallopt(TRIM_THRESHOLD, LARGEST_KEPT_BYTES)
