"""Whether the disk keeps up with the recorder, and for how long it has room."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from pathlib import Path

from hil.doctor.finding import Finding

TRIED_BYTES = 16 << 20
BLOCK_BYTES = 1 << 20
AT_MOST_S = 3.0
SPARE = 10.0
"""How many times faster than its rows a disk should be: a journal is converted to MDF4 while the next recording may begin."""
ENOUGH_S, LITTLE_S = 3600.0, 600.0
"""Recording that should find room: an hour; with less than ten minutes a longer experiment ends with a full disk."""


def free_bytes(folder: Path) -> int | None:
    """Return the free space of a folder's disk; None where there is no such folder."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def written_bytes_s(folder: Path) -> float:
    """Measure how fast the folder's disk takes data [byte/s]; the file is removed.

    Raises
    ------
    OSError
        Nothing can be written there.
    """
    block, done, began_s = os.urandom(BLOCK_BYTES), 0, time.perf_counter()
    with tempfile.TemporaryFile(dir=folder) as file:
        while done < TRIED_BYTES and time.perf_counter() - began_s < AT_MOST_S:
            file.write(block)
            file.flush()
            os.fsync(file.fileno())
            done += BLOCK_BYTES
    return done / (time.perf_counter() - began_s)


def disk(folder: Path, needed_bytes_s: float, speed_bytes_s: float | None, free: int | None) -> Finding:
    """Compare a disk with the rows of a recording; a speed of None: nothing can be written."""
    if speed_bytes_s is None or free is None:
        return Finding("bad", "disk", f"{folder} cannot be written to", "start in a folder that can")
    lasts_s = free / needed_bytes_s
    found = f"{speed_bytes_s / 1e6:.0f} MB/s in {folder}, rows take {needed_bytes_s / 1e6:.2g} MB/s; room for {lasts_s / 3600.0:.1f} h"
    if speed_bytes_s < needed_bytes_s or lasts_s < LITTLE_S:
        return Finding("bad", "disk", found, "record to a faster disk, or one with more room")
    if speed_bytes_s < SPARE * needed_bytes_s or lasts_s < ENOUGH_S:
        return Finding("look", "disk", found, f"{SPARE:g} times the rows' rate and room for an hour would be right")
    return Finding("ok", "disk", found)
