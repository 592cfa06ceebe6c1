"""Receive PDOs: when they are applied, their length and their deadline. No command object is ever mapped or sent."""

from __future__ import annotations

from canopen.objectdictionary import ODVariable

from hil.conform.check import Checks
from hil.conform.checks.error_control import LATE_S, emergency_id
from hil.conform.checks.sync import need_sync
from hil.conform.device import Device
from hil.conform.pdo_setup import dummy_rpdo, mapping_of, one, set_up
from hil.conform.wire import QUIET_S

CHECKS = Checks("receive PDOs")
check = CHECKS.check
_TOO_SHORT, _TOO_LONG, _TIMED_OUT = b"\x10\x82", b"\x20\x82", b"\x50\x82"
_DEADLINE_MS = 100


def _emergencies(device: Device, code: bytes, since: int) -> bool:
    device.wire.listen(LATE_S)
    return any(frame.data[:2] == code for frame in device.wire.heard(emergency_id(device), since))


@check("a PDO that is too short is reported: EMCY 8210h", "7.2.2.5.1")
def short(device: Device) -> None:
    """Send one byte of two."""
    emergency_id(device)
    can_id = dummy_rpdo(device, 255)
    since = device.go_operational()
    device.wire.send(can_id, b"\0")
    device.expect(_emergencies(device, _TOO_SHORT, since), "EMCY with 10 82")


@check("a PDO that is too long is taken or reported (EMCY 8220h), never as too short", "7.2.2.5.1")
def long(device: Device) -> None:
    """Send three bytes of two."""
    emergency_id(device)
    can_id = dummy_rpdo(device, 255)
    since = device.go_operational()
    device.wire.send(can_id, bytes(3))
    device.expect(not _emergencies(device, _TOO_SHORT, since), "no EMCY with 10 82")
    device.expect(device.is_alive(), "the SDO server answers")


@check("a PDO of the right length is not reported", "7.2.2.5.1")
def right(device: Device) -> None:
    """Send two bytes of two."""
    can_id = dummy_rpdo(device, 255)
    since = device.go_operational()
    device.wire.send(can_id, bytes(2))
    device.wire.listen(QUIET_S)
    device.expect(not device.wire.heard(emergency_id(device), since), "no EMCY", device.wire.heard(emergency_id(device), since))


@check("a PDO that stays away for longer than its deadline is reported: EMCY 8250h", "7.5.2.35")
def deadline(device: Device) -> None:
    """Send one, then none."""
    emergency_id(device)
    can_id = dummy_rpdo(device, 255, event=_DEADLINE_MS)
    since = device.go_operational()
    device.wire.send(can_id, bytes(2))
    device.wire.listen(0.7e-3 * _DEADLINE_MS)
    device.expect(
        not device.wire.heard(emergency_id(device), since), "no EMCY before the deadline", device.wire.heard(emergency_id(device), since)
    )
    device.wire.listen(1e-3 * _DEADLINE_MS)
    device.expect(_emergencies(device, _TIMED_OUT, since), "EMCY with 50 82")


@check("a PDO that never came is not missed", "7.5.2.35")
def deadline_begins(device: Device) -> None:
    """Send none."""
    emergency_id(device)
    dummy_rpdo(device, 255, event=_DEADLINE_MS)
    since = device.go_operational()
    device.wire.listen(2e-3 * _DEADLINE_MS)
    device.expect(not device.wire.heard(emergency_id(device), since), "no EMCY", device.wire.heard(emergency_id(device), since))


def _spare(device: Device, transmission: int) -> tuple[ODVariable, int, bytes, bytes]:
    """Map the spare object; return it, the identifier, its value and another one."""
    entry = device.spare_object()
    can_id = set_up(device, one(device, receive=True), transmission, [mapping_of(entry)])
    old = device.read(entry.index, entry.subindex)
    new = bytes((old[0] ^ 1,)) + old[1:]
    device.expect(device.try_write(entry.index, entry.subindex, old) == 0, f"{entry.index:04X}h takes its own value")
    return entry, can_id, old, new


@check("transmission type {} is applied when it comes", "7.5.2.35", of=lambda device: [254, 255], writes=True)
def at_once(device: Device, kind: int) -> None:
    """Send a value and read it."""
    entry, can_id, _, new = _spare(device, kind)
    device.go_operational()
    device.wire.send(can_id, new)
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == new, f"{new.hex(' ').upper()}")


@check("transmission type {} is applied at the next SYNC", "7.5.2.35", of=lambda device: [0, 1, 240], writes=True)
def at_sync(device: Device, kind: int) -> None:
    """Send a value, and a SYNC."""
    sync_id = need_sync(device)
    entry, can_id, old, new = _spare(device, kind)
    device.go_operational()
    device.wire.send(can_id, new)
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == old, f"{old.hex(' ').upper()} before the SYNC")
    device.wire.send(sync_id)
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == new, f"{new.hex(' ').upper()} after it")


@check("a PDO is not applied in pre-operational", "7.3.2.2", writes=True)
def pre_operational(device: Device) -> None:
    """Send a value where PDOs are not permitted."""
    entry, can_id, old, new = _spare(device, 255)
    device.wire.send(can_id, new)
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == old, f"{old.hex(' ').upper()}, as before")


@check("a PDO that is too short is not applied, and the next that is right is", "7.2.2.5.1", writes=True)
def short_not_applied(device: Device) -> None:
    """Send a byte too few, then all."""
    entry, can_id, old, new = _spare(device, 255)
    device.go_operational()
    device.wire.send(can_id, new[:-1])
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == old, f"{old.hex(' ').upper()}, as before")
    device.wire.send(can_id, new)
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == new, f"{new.hex(' ').upper()} when all bytes come")


@check("the first bytes of a PDO that is too long are applied", "7.2.2.5.1", writes=True)
def long_applied(device: Device) -> None:
    """Send a byte too many: the consumer uses those that are mapped."""
    entry, can_id, _, new = _spare(device, 255)
    device.go_operational()
    device.wire.send(can_id, new + b"\xff")
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == new, f"{new.hex(' ').upper()}")


@check("an RPDO that is off is not applied", "7.5.2.35", writes=True)
def off(device: Device) -> None:
    """Switch it off and send a value."""
    entry, can_id, old, new = _spare(device, 255)
    pdo = one(device, receive=True)
    device.write(pdo.communication, 1, device.number(pdo.communication, 1) | 1 << 31)
    device.go_operational()
    device.wire.send(can_id, new)
    device.wire.listen(0.02)
    device.expect(device.read(entry.index, entry.subindex) == old, f"{old.hex(' ').upper()}, as before")
