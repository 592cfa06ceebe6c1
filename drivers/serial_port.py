"""Why a serial port is not opened, as the system says it, and what helps there."""

from __future__ import annotations

import errno
import os

_WAY_OUT = {
    errno.ENOENT: "name a port that exists",
    errno.EACCES: "run as a user who may open it, on Linux often one of the group dialout",
    errno.EPERM: "run as a user who may open it, on Linux often one of the group dialout",
}
_IN_USE = (errno.EBUSY, errno.EAGAIN)
"""Of a port that another program has claimed, and of one that it has locked."""


def why_not_opened(error: OSError | ValueError) -> str:
    """Return the reason for a port that was not opened, with the way out where the reason has one."""
    number = error.errno if isinstance(error, OSError) else None
    if number is None:
        return str(error)
    if number in _IN_USE:
        return "another program has it open; end that program"
    way_out = _WAY_OUT.get(number, "")
    return os.strerror(number) + (f"; {way_out}" if way_out else "")
