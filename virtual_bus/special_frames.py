"""Frames that are no data frame with an 11-bit identifier, told apart by flags in the identifier as SocketCAN does (linux/can.h)."""

from __future__ import annotations

import can

EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
FLAGS = EXTENDED | REMOTE | ERROR
ERROR_BUS_OFF, ERROR_BUS_ERROR = 0x040, 0x080  # class bits in the identifier of an error frame
ERROR_BYTES = 8


def message_of(can_id: int, data: bytes) -> can.Message:
    """Return the python-can message of an identifier with flags."""
    return can.Message(
        arbitration_id=can_id & ~FLAGS,
        data=b"" if can_id & REMOTE else data,
        dlc=len(data),
        is_extended_id=bool(can_id & EXTENDED),
        is_remote_frame=bool(can_id & REMOTE),
        is_error_frame=bool(can_id & ERROR),
    )
