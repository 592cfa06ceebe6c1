"""Emergency messages, the error history and the error register, with a heartbeat that stays away as the error."""

from __future__ import annotations

from drivers.canopen.network import HEARTBEAT
from hil.conform.aborts import BAD_VALUE, NO_DATA
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.checks.error_control import LATE_S, LOST, beat, consume, emergency_id, lose, producer_id
from hil.conform.device import INVALID, Device
from hil.conform.pdo_setup import dummy_rpdo
from hil.conform.wire import QUIET_S, Frame

CHECKS = Checks("emergency")
check = CHECKS.check
_NO_ERROR, _TOO_SHORT = b"\0\0", b"\x10\x82"
_INHIBIT_MS = 400
_MOVED = 0x0A5


def _lost(device: Device) -> tuple[Frame, int]:
    """Fall silent; return the emergency message and the identifier of the heartbeat."""
    can_id = emergency_id(device)
    heartbeat_id = consume(device)
    since = lose(device, heartbeat_id)
    frames = [frame for frame in device.wire.heard(can_id, since) if frame.data[:2] == LOST]
    device.expect(bool(frames), f"EMCY 8130h: {can_id:03X} 30 81")
    device.must_reset()
    return frames[0], heartbeat_id


@check("an error is told in eight bytes, with the register that 1001h shows", "7.2.7.3")
def message(device: Device) -> None:
    """Raise an error, and read 1001h."""
    frame, _ = _lost(device)
    device.expect(len(frame.data) == 8, "eight bytes", [frame])
    register = device.number(0x1001)
    device.expect(register & 1 == 1, "bit 0 of 1001h while there is an error")
    device.expect(frame.data[2] == register, f"the register {register:02X}h in byte 2", [frame])


@check("an error that lasts is told once", "7.2.7.1")
def once(device: Device) -> None:
    """Raise an error, and wait."""
    _lost(device)
    since = device.wire.mark()
    device.wire.listen(0.3)
    device.expect(not device.wire.heard(emergency_id(device), since), "silence", device.wire.heard(emergency_id(device), since))


@check("an error that is gone is told: EMCY 0000h, and 1001h is clear", "7.2.7.1")
def gone(device: Device) -> None:
    """Raise an error, and take its cause away."""
    _, heartbeat_id = _lost(device)
    since = device.wire.mark()
    beat(device, heartbeat_id, 2)
    frames = device.wire.heard(emergency_id(device), since)
    device.expect(any(frame.data[:2] == _NO_ERROR for frame in frames), "EMCY with 00 00")
    device.expect(device.number(0x1001) & 0x10 == 0, "bit 4 of 1001h clear")


@check("an error is the first of the history 1003h", "7.5.2.4")
def history(device: Device) -> None:
    """Raise an error, and read 1003h."""
    device.need(0x1003, 1, writable=False)
    _lost(device)
    device.expect(device.number(0x1003) >= 1, "a count of 1 or more")
    device.expect(device.read(0x1003, 1)[:2] == LOST, "30 81")


@check("a newer error comes before an older one in the history 1003h", "7.5.2.4")
def history_order(device: Device) -> None:
    """Send a PDO that is too short, then fall silent."""
    device.need(0x1003, 2, writable=False)
    can_id = dummy_rpdo(device, 255)
    since = device.go_operational()
    device.wire.send(can_id, b"\0")
    device.wire.listen(LATE_S)
    if not any(frame.data[:2] == _TOO_SHORT for frame in device.wire.heard(emergency_id(device), since)):
        raise CheckSkippedError("a PDO that is too short raises no error")
    _lost(device)
    device.expect(device.read(0x1003, 1)[:2] == LOST, "30 81 in 1003h:01")
    device.expect(device.read(0x1003, 2)[:2] == _TOO_SHORT, "10 82 in 1003h:02")


@check("0 to 1003h:00 clears the history", "7.5.2.4")
def history_cleared(device: Device) -> None:
    """Raise an error, and clear the history."""
    device.need(0x1003)
    _lost(device)
    device.expect(device.number(0x1003) >= 1, "a count of 1 or more")
    device.write(0x1003, 0, 0)
    device.expect(device.number(0x1003) == 0, "a count of 0")
    code = device.try_read(0x1003, 1)
    device.expect(code == NO_DATA or code == bytes(4), "no error in 1003h:01: abort 0800 0024h, or zero")


@check("another value than 0 to 1003h:00 is refused", "7.5.2.4")
def history_count(device: Device) -> None:
    """Write a count."""
    device.need(0x1003)
    device.expect_code(device.try_number(0x1003, 0, 1), BAD_VALUE, "1 is refused")


@check("emergency messages are sent with the identifier of 1014h", "7.5.2.17")
def moved(device: Device) -> None:
    """Move them."""
    device.need(0x1014)
    old = emergency_id(device)
    heartbeat_id = consume(device)
    device.write(0x1014, 0, old | INVALID)
    device.write(0x1014, 0, _MOVED)
    since = lose(device, heartbeat_id)
    device.must_reset()
    device.expect(bool(device.wire.heard(_MOVED, since)), f"EMCY with {_MOVED:03X}h")
    device.expect(not device.wire.heard(old, since), f"none with {old:03X}h", device.wire.heard(old, since))


@check("emergency messages that are switched off are not sent", "7.5.2.17")
def switched_off(device: Device) -> None:
    """Set bit 31 of 1014h."""
    device.need(0x1014)
    old = emergency_id(device)
    heartbeat_id = consume(device)
    device.write(0x1014, 0, old | INVALID)
    since = lose(device, heartbeat_id)
    device.must_reset()
    device.expect(not device.wire.heard(old, since), "silence", device.wire.heard(old, since))


@check("the inhibit time 1015h keeps emergency messages apart", "7.5.2.18")
def inhibit(device: Device) -> None:
    """Raise an error and take it away within the inhibit time."""
    device.need(0x1015)
    device.write(0x1015, 0, 10 * _INHIBIT_MS)
    first, heartbeat_id = _lost(device)
    device.wire.send(heartbeat_id, b"\x05")
    again = device.wire.wait(emergency_id_of(first), 1e-3 * _INHIBIT_MS + LATE_S)
    device.expect(again is not None, "the second message when the inhibit time is over")
    assert again is not None
    apart = 1e3 * (again.time_s - first.time_s)
    device.expect(apart >= 0.9 * _INHIBIT_MS, f"at least {_INHIBIT_MS} ms between messages, not {apart:.0f} ms", [first, again])


def emergency_id_of(frame: Frame) -> int:
    """Return the identifier of an emergency message."""
    return frame.can_id


@check("no emergency message is sent in stopped", "7.3.2.2")
def stopped(device: Device) -> None:
    """Fall silent towards a node that is stopped."""
    can_id = emergency_id(device)
    heartbeat_id = consume(device)
    beat(device, heartbeat_id)
    device.must_reset()
    device.nmt(0x02)
    since = lose(device, heartbeat_id)
    device.expect(not device.wire.heard(can_id, since), "silence", device.wire.heard(can_id, since))


@check("a heartbeat without its byte keeps nobody alive", "7.2.8.3.2.2")
def empty_heartbeat(device: Device) -> None:
    """Send frames that are no heartbeats."""
    can_id = emergency_id(device)
    consume(device)
    beat(device, HEARTBEAT + producer_id(device))
    device.must_reset()
    since = device.wire.mark()
    for _ in range(6):
        device.wire.send(HEARTBEAT + producer_id(device), b"")
        device.wire.listen(QUIET_S)
    if not any(frame.data[:2] == LOST for frame in device.wire.heard(can_id, since)):
        raise CheckSkippedError("the device takes a frame without data for a heartbeat; the standard does not say what such a frame is")
