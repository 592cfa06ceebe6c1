"""Settings of the C library with which freed memory stays with the process, for the next run to use.

A simulation of a minute allocates and frees thirty arrays of one to twenty megabytes. The C library would return each of them to the
kernel, which clears every page when it is touched again: an eleventh of a diagnosis' processor time, while other threads wait.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's `mallopt`: free bytes at the heap's end from which it shrinks, and sizes from which an array is mapped separately.
Keeping empty heaps of threads as well (M_TOP_PAD) saves half a second more and costs 0.16 GB."""

LARGEST_KEPT_BYTES = 1 << 30
"""Larger than any array of a diagnosis of a minute: the sensitivities of 49 parameters of the C-arm have 70 MB."""

LARGEST_OF_OLDER_BYTES = 32 << 20
"""Largest size that glibc accepts where its heaps have 64 MB: it refuses more than half a heap (malloc.c, do_set_mmap_threshold); newer
versions do not on x86-64."""


def keep_memory() -> None:
    """Keep freed memory in this process.

    Does nothing with another C library, or one that accepts neither size: the other threshold alone would make every array a new mapping.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None and any(mallopt(MMAP_THRESHOLD, size) for size in (LARGEST_KEPT_BYTES, LARGEST_OF_OLDER_BYTES)):
        mallopt(TRIM_THRESHOLD, LARGEST_KEPT_BYTES)
