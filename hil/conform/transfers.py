"""SDO transfers as CiA 301, 7.2.4.3, writes them, frame by frame: what the answers must be is checked by those who ask."""

from __future__ import annotations

import struct

from hil.conform.wire import Wire

NO_ANSWER = -1
MALFORMED = -2
MOST_BYTES = 65536
ABORT = 0x80


def head(command: int, index: int, subindex: int, value: int = 0) -> bytes:
    """Return an SDO frame that begins with a multiplexer."""
    return struct.pack("<BHBI", command, index, subindex, value)


def abort_code(answer: bytes | None) -> int:
    """Return the code of an abort, 0 for another answer, `NO_ANSWER` for none."""
    if answer is None:
        return NO_ANSWER
    return int.from_bytes(answer[4:8], "little") if answer[0] == ABORT else 0


def upload(wire: Wire, index: int, subindex: int) -> bytes | int:
    """Return the value of an object, or the abort code, `NO_ANSWER` or `MALFORMED`."""
    answer = wire.sdo(head(0x40, index, subindex))
    if answer is None or answer[0] == ABORT:
        return abort_code(answer)
    if answer[0] >> 5 != 2 or answer[1:4] != head(0, index, subindex)[1:4]:
        return MALFORMED
    if answer[0] & 2:
        return answer[4 : 8 - (answer[0] >> 2 & 3)] if answer[0] & 1 else answer[4:]
    data, toggle = b"", 0
    while len(data) < MOST_BYTES:
        answer = wire.sdo(bytes((0x60 | toggle,)))
        if answer is None or answer[0] == ABORT:
            return abort_code(answer)
        if answer[0] >> 5 != 0:
            return MALFORMED
        data += answer[1 : 8 - (answer[0] >> 1 & 7)]
        if answer[0] & 1:
            return data
        toggle ^= 0x10
    return MALFORMED


def download(wire: Wire, index: int, subindex: int, data: bytes) -> int:
    """Write an object; return 0, the abort code, `NO_ANSWER` or `MALFORMED`."""
    if 1 <= len(data) <= 4:
        request = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data
        return _confirmed(wire.sdo(request), 0x60)
    if code := _confirmed(wire.sdo(head(0x21, index, subindex, len(data))), 0x60):
        return code
    toggle = 0
    pieces = [data[i : i + 7] for i in range(0, len(data), 7)] or [b""]
    for number, piece in enumerate(pieces):
        last = int(number == len(pieces) - 1)
        answer = wire.sdo(bytes((toggle | (7 - len(piece)) << 1 | last,)) + piece)
        if code := _confirmed(answer, 0x20 | toggle):
            return code
        toggle ^= 0x10
    return 0


def _confirmed(answer: bytes | None, command: int) -> int:
    if answer is None or answer[0] == ABORT:
        return abort_code(answer)
    return 0 if answer[0] == command else MALFORMED
