"""Rules of a device's communication parameters (CiA 301, 7.5.2)."""

from __future__ import annotations

from virtual_bus.canopen import abort, cob_id
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Objects, Value, key_of
from virtual_bus.canopen.time_stamp import CONSUMES, PRODUCES

GENERATES_SYNC = cob_id.NO_RTR  # bit 30 of 1005h
_MAX_COUNTER = 240
_ERROR_BEHAVIOUR = range(3)  # 1029h: pre-operational, no change, stopped


def install(objects: Objects) -> None:
    """Add the rules of 1005h, 1012h, 1014h, 1019h and 1029h to the dictionary."""
    can_generate_sync = 0x1006 in objects

    def check_sync(value: Value) -> None:
        old = objects.number(0x1005)
        if int(value) & GENERATES_SYNC and not can_generate_sync:
            raise SdoAbortError(abort.INVALID_VALUE)
        cob_id.check_change(old, int(value) & ~cob_id.INVALID, exists=bool(old & GENERATES_SYNC))

    def check_emergency(value: Value) -> None:
        old = objects.number(0x1014)
        cob_id.check_change(old, int(value), exists=not old & cob_id.INVALID)

    def check_time(value: Value) -> None:
        if int(value) & PRODUCES:
            raise SdoAbortError(abort.INVALID_VALUE)
        cob_id.check_change(objects.number(0x1012), int(value) & ~CONSUMES, exists=False)

    def check_error_behaviour(value: Value) -> None:
        if int(value) not in _ERROR_BEHAVIOUR:
            raise SdoAbortError(abort.INVALID_VALUE)

    def check_counter(value: Value) -> None:
        if value == 1 or int(value) > _MAX_COUNTER:
            raise SdoAbortError(abort.INVALID_VALUE)
        if objects.number(0x1006):
            raise SdoAbortError(abort.DEVICE_STATE)

    objects.checks[key_of(0x1005)] = check_sync
    objects.checks[key_of(0x1012)] = check_time
    objects.checks[key_of(0x1014)] = check_emergency
    for entry in objects:
        if entry.index == 0x1029 and entry.subindex:
            objects.checks[entry.key] = check_error_behaviour
    objects.checks[key_of(0x1019)] = check_counter
