"""What the objects that hold an identifier take and refuse: PDOs, SYNC, EMCY, TIME."""

from __future__ import annotations

from collections.abc import Iterable

from hil.conform.aborts import BAD_VALUE, NOT_NOW
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import INVALID, Device, Pdo
from hil.conform.pdo_setup import CAN_ID, first_pdos, free_id, turn_off

CHECKS = Checks("COB-IDs")
check = CHECKS.check
RESTRICTED = (0x000, 0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x6FF, 0x701, 0x77F, 0x780, 0x7FF)
"""The ends of the ranges of table 41."""
ALLOWED = (0x181, 0x57F, 0x680, 0x6DF)
_EXTENDED, _GENERATES, _FREE, _OTHER_FREE = 1 << 29, 1 << 30, 0x0A5, 0x0A6
_NAMES = {"1005h": 0x1005, "1012h": 0x1012, "1014h": 0x1014}


def _present(device: Device) -> Iterable[str]:
    return list(_NAMES)


def _restore_if_taken(device: Device, index: int, subindex: int, value: int, what: str) -> None:
    """Write a value that must be refused."""
    code = device.try_number(index, subindex, value)
    device.expect_code(code, (*BAD_VALUE, *NOT_NOW), what)


@check("{}:01 takes no restricted identifier", "7.3.5", of=first_pdos)
def pdo_restricted(device: Device, pdo: Pdo) -> None:
    """Switch a PDO on with each of the restricted identifiers."""
    flags = turn_off(device, pdo) & _GENERATES
    for can_id in RESTRICTED:
        _restore_if_taken(device, pdo.communication, 1, can_id | flags, f"identifier {can_id:03X}h is refused")


@check("{}:01 takes the identifiers next to the restricted ones", "7.3.5", of=first_pdos)
def pdo_allowed(device: Device, pdo: Pdo) -> None:
    """Switch a PDO on with identifiers at the ends of the allowed ranges; the node is in pre-operational and sends none."""
    for can_id in ALLOWED:
        flags = turn_off(device, pdo) & _GENERATES
        device.expect_code(device.try_number(pdo.communication, 1, can_id | INVALID | flags), (0,), f"{can_id:03X}h is taken, off")
        device.expect_code(device.try_number(pdo.communication, 1, can_id | flags), (0,), f"{can_id:03X}h is taken, on")


@check("{}:01 does not change its identifier while the PDO is on", "7.5.2.35 and 7.5.2.37", of=first_pdos)
def pdo_fixed_while_on(device: Device, pdo: Pdo) -> None:
    """Change the identifier of a PDO that is on."""
    flags = turn_off(device, pdo) & _GENERATES
    can_id = free_id(device, pdo)
    device.write(pdo.communication, 1, can_id | flags)
    _restore_if_taken(
        device, pdo.communication, 1, (can_id ^ 1 if can_id & 0x7F > 1 else can_id + 2) | flags, "another identifier is refused"
    )
    device.expect(device.number(pdo.communication, 1) & CAN_ID == can_id, f"the identifier is still {can_id:03X}h")


@check("{}:01 takes another identifier while the PDO is off, and goes on with it", "7.5.2.35 and 7.5.2.37", of=first_pdos)
def pdo_moves(device: Device, pdo: Pdo) -> None:
    """Move a PDO."""
    flags = turn_off(device, pdo) & _GENERATES
    device.write(pdo.communication, 1, _FREE + 0x140 | INVALID | flags)
    device.write(pdo.communication, 1, _FREE + 0x140 | flags)
    device.expect(device.number(pdo.communication, 1) & (INVALID | CAN_ID) == _FREE + 0x140, f"{_FREE + 0x140:03X}h, on")


@check("{}:01 takes 29-bit identifiers wholly or not at all", "7.5.2.35 and 7.5.2.37", of=first_pdos)
def pdo_extended(device: Device, pdo: Pdo) -> None:
    """Give an 11-bit frame an identifier of more bits, and set bit 29."""
    flags = turn_off(device, pdo) & _GENERATES
    _restore_if_taken(device, pdo.communication, 1, 0x1000 | free_id(device, pdo) | flags, "bit 12 with bit 29 clear is refused")
    value = _EXTENDED | free_id(device, pdo) | flags
    if device.try_number(pdo.communication, 1, value) == 0:
        device.expect(device.number(pdo.communication, 1) == value, "what was taken is read back")


@check("{} takes no restricted identifier", "7.3.5", of=_present)
def restricted(device: Device, name: str) -> None:
    """Write each of the restricted identifiers."""
    index = _NAMES[name]
    device.need(index)
    before = device.number(index)
    used = before & INVALID if index == 0x1012 else 0
    if index == 0x1014 and not before & INVALID:
        device.write(index, 0, before | INVALID)
    for can_id in RESTRICTED:
        if can_id != before & CAN_ID:
            _restore_if_taken(device, index, 0, can_id | used, f"identifier {can_id:03X}h is refused")


@check("1012h takes no restricted identifier while time stamps are consumed", "7.3.5")
def time_restricted(device: Device) -> None:
    """Write restricted identifiers with bit 31."""
    device.need(0x1012)
    for can_id in RESTRICTED:
        _restore_if_taken(device, 0x1012, 0, can_id | INVALID, f"identifier {can_id:03X}h with bit 31 is refused")


@check("1014h does not change its identifier while emergency messages are on", "7.5.2.17")
def emergency_fixed(device: Device) -> None:
    """Change the identifier of EMCY."""
    device.need(0x1014)
    before = device.number(0x1014)
    if before & INVALID:
        raise CheckSkippedError("emergency messages are switched off (1014h bit 31)")
    _restore_if_taken(device, 0x1014, 0, _FREE if before & CAN_ID != _FREE else _OTHER_FREE, "another identifier is refused")


@check("1014h takes another identifier while emergency messages are off", "7.5.2.17")
def emergency_moves(device: Device) -> None:
    """Move EMCY."""
    device.need(0x1014)
    before = device.number(0x1014)
    device.write(0x1014, 0, before | INVALID)
    new = _FREE if before & CAN_ID != _FREE else _OTHER_FREE
    device.write(0x1014, 0, new)
    device.expect(device.number(0x1014) & (INVALID | CAN_ID) == new, f"{new:03X}h")


@check("1005h takes an allowed identifier", "7.5.2.5")
def sync_moves(device: Device) -> None:
    """Move SYNC."""
    device.need(0x1005)
    device.write(0x1005, 0, _FREE)
    device.expect(device.number(0x1005) & CAN_ID == _FREE, f"{_FREE:03X}h")


@check("1005h does not change its identifier while the node generates SYNC", "7.5.2.5")
def sync_fixed(device: Device) -> None:
    """Change the identifier of a producer; its period is zero, so that none is sent."""
    device.need(0x1005)
    device.need(0x1006)
    device.write(0x1006, 0, 0)
    before = device.number(0x1005) & CAN_ID
    if device.try_number(0x1005, 0, before | _GENERATES):
        raise CheckSkippedError("the device does not generate SYNC (1005h bit 30)")
    code = device.try_number(0x1005, 0, (before ^ 1) | _GENERATES)
    device.expect_code(code, (*BAD_VALUE, *NOT_NOW), "another identifier is refused")


@check("1012h takes an allowed identifier, and a time stamp harms nothing", "7.5.2.15")
def time_stamp(device: Device) -> None:
    """Move TIME, and send one whole and one cut stamp."""
    device.need(0x1012)
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, which a time stamp would reach")
    device.write(0x1012, 0, _FREE)
    if device.try_number(0x1012, 0, _FREE | INVALID):
        raise CheckSkippedError("the device does not consume time stamps (1012h bit 31)")
    for stamp in (b"\x00\x10\x20\x03\x10\x3a", b"\x00\x10"):
        device.wire.send(_FREE, stamp)
    device.expect(device.is_alive(), "the SDO server answers")
