"""Emergency messages, error register and error history (CiA 301, 7.2.7)."""

from __future__ import annotations

import math
import struct
from collections import deque
from functools import partial

from virtual_bus.canopen import abort, cob_id
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Value, key_of
from virtual_bus.canopen.port import Port

GENERIC, CURRENT, VOLTAGE, TEMPERATURE, COMMUNICATION, PROFILE, MANUFACTURER = 0x01, 0x02, 0x04, 0x08, 0x10, 0x20, 0x80
_REGISTER_OF_CLASS = {0x2: CURRENT, 0x3: VOLTAGE, 0x4: TEMPERATURE, 0x8: COMMUNICATION}
_FRAME = struct.Struct("<HB5s")
_NO_ERROR = 0x0000
HEARTBEAT_ERROR = 0x8130
_PROTOCOL_ERRORS = range(0x8200, 0x8300)  # PDO and SYNC


def register_bit(code: int) -> int:
    """Return the error register's bit that goes with an EMCY code."""
    if 0xFF00 <= code <= 0xFFFF or 0x8300 <= code <= 0x8FFF:  # device specific, or of a drive's controllers: 8611h is a following error
        return PROFILE
    return _REGISTER_OF_CLASS.get(code >> 12, 0)


class Emergency:
    """The errors of a device: raised and cleared, told to the bus once each, and kept in 1001h and 1003h."""

    def __init__(self, node: Port) -> None:
        self._node = node
        self._active: dict[int, int] = {}  # code -> register bits
        self._queue: deque[bytes] = deque()  # held back by the inhibit time
        self._not_before_s = -math.inf
        self._history_room = max((entry.subindex for entry in node.objects if entry.index == 0x1003), default=0)
        self.deadline_s = math.inf
        node.objects.checks[key_of(0x1003)] = self._check_history_count
        node.objects.effects[key_of(0x1003)] = self._clear_history
        for subindex in range(1, self._history_room + 1):
            node.objects.readings[key_of(0x1003, subindex)] = partial(self._history, subindex)

    def reset(self, *, application: bool) -> None:
        """Clear the history and the queue. Errors of the application outlive a reset of communication alone."""
        over = (HEARTBEAT_ERROR, *_PROTOCOL_ERRORS)
        self._active = {} if application else {code: bits for code, bits in self._active.items() if code not in over}
        self._queue.clear()
        self._not_before_s, self.deadline_s = -math.inf, math.inf
        self._update_register()
        self._clear_history(0)

    @property
    def active(self) -> tuple[int, ...]:
        """Codes of the errors that are active, oldest first."""
        return tuple(self._active)

    def raise_error(self, code: int, manufacturer: bytes = b"") -> None:
        """Raise an error and tell it; one that is already active is not told again."""
        if code in self._active:
            return
        self._active[code] = GENERIC | register_bit(code)
        self._update_register()
        self._remember(code, manufacturer)
        self._tell(code, manufacturer)

    def clear_error(self, code: int) -> None:
        """Clear an error and send EMCY 0000h with what the register still shows."""
        if self._active.pop(code, None) is None:
            return
        self._update_register()
        self._tell(_NO_ERROR, b"")

    def _update_register(self) -> None:
        register = 0
        for bits in self._active.values():
            register |= bits
        if entry := self._node.objects.get(0x1001):
            entry.value = register

    def _tell(self, code: int, manufacturer: bytes) -> None:
        self._queue.append(_FRAME.pack(code, self._node.objects.number(0x1001), manufacturer.ljust(5, b"\0")[:5]))
        self.expire(self._node.clock.now_s)

    def expire(self, now_s: float) -> None:
        """Send what the inhibit time has held back."""
        inhibit_s = self._node.objects.number(0x1015) * 1e-4
        while self._queue and now_s >= self._not_before_s:
            self._send(self._queue.popleft())
            self._not_before_s = self._node.after(inhibit_s) if inhibit_s else -math.inf
        self.deadline_s = self._not_before_s if self._queue else math.inf
        self._node.schedule(self.deadline_s)

    def _send(self, frame: bytes) -> None:
        target = self._node.objects.number(0x1014, 0, cob_id.INVALID)
        if not target & cob_id.INVALID and self._node.may_tell:
            self._node.emit(target & cob_id.CAN_ID, frame)

    def _remember(self, code: int, manufacturer: bytes) -> None:
        objects = self._node.objects
        for subindex in range(self._history_room, 1, -1):
            objects.find(0x1003, subindex).value = objects.find(0x1003, subindex - 1).value
        if self._history_room:
            objects.find(0x1003, 1).value = code | int.from_bytes(manufacturer[:2], "little") << 16
            objects.find(0x1003).value = min(objects.number(0x1003) + 1, self._history_room)

    def _history(self, subindex: int) -> Value:
        if subindex > self._node.objects.number(0x1003):
            raise SdoAbortError(abort.NO_DATA)
        return self._node.objects.find(0x1003, subindex).value

    @staticmethod
    def _check_history_count(value: Value) -> None:
        if value != 0:
            raise SdoAbortError(abort.INVALID_VALUE)

    def _clear_history(self, value: Value) -> None:
        for subindex in range(self._history_room + 1):
            if entry := self._node.objects.get(0x1003, subindex):
                entry.value = 0
