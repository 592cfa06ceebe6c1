"""Consumer of the time stamp object (CiA 301, 7.2.6), of a device that has 1012h."""

from __future__ import annotations

import datetime

TIME_BYTES = 6
CONSUMES, PRODUCES = 1 << 31, 1 << 30  # bits of 1012h
_EPOCH = datetime.datetime(1984, 1, 1)
_MILLISECONDS = 0x0FFF_FFFF  # the four bits above are reserved


def time_of_day(data: bytes) -> datetime.datetime:
    """Return what a time stamp of six bytes says: milliseconds since midnight, days since 1 January 1984."""
    milliseconds = int.from_bytes(data[:4], "little") & _MILLISECONDS
    return _EPOCH + datetime.timedelta(days=int.from_bytes(data[4:6], "little"), milliseconds=milliseconds)
