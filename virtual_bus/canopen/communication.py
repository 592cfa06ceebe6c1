"""Rules of a device's communication parameters (CiA 301, 7.5.2)."""

from __future__ import annotations

from virtual_bus.canopen import abort, cob_id
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.objects import Objects, Value, key_of

GENERATES_SYNC = cob_id.NO_RTR  # bit 30 of 1005h
_MAX_COUNTER = 240


def install(objects: Objects) -> None:
    """Add the rules of 1005h, 1012h, 1014h and 1019h to the dictionary."""
    can_generate_sync = 0x1006 in objects

    def check_sync(value: Value) -> None:
        old = objects.number(0x1005)
        if int(value) & GENERATES_SYNC and not can_generate_sync:
            raise SdoAbortError(abort.INVALID_VALUE)
        cob_id.check_change(old, int(value) & ~cob_id.INVALID, exists=bool(old & GENERATES_SYNC))

    def check_plain(index: int) -> None:
        def check(value: Value) -> None:
            old = objects.number(index)
            cob_id.check_change(old, int(value), exists=index == 0x1014 and not old & cob_id.INVALID)

        objects.checks[key_of(index)] = check

    def check_counter(value: Value) -> None:
        if value == 1 or int(value) > _MAX_COUNTER:
            raise SdoAbortError(abort.INVALID_VALUE)
        if objects.number(0x1006):
            raise SdoAbortError(abort.DEVICE_STATE)

    objects.checks[key_of(0x1005)] = check_sync
    check_plain(0x1012)
    check_plain(0x1014)
    objects.checks[key_of(0x1019)] = check_counter
