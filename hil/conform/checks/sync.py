"""SYNC: its counter, and what a node without one does."""

from __future__ import annotations

from hil.conform.aborts import BAD_VALUE, DEVICE_STATE, NOT_NOW
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import Device
from hil.conform.pdo_setup import tpdo
from hil.conform.wire import QUIET_S

CHECKS = Checks("SYNC")
check = CHECKS.check
OVERFLOW = 10
_ANSWER_S = 0.05  # for a PDO after its SYNC


def need_sync(device: Device) -> int:
    """Return SYNC's identifier; skip the check where the node has none, or others would obey it."""
    device.need(0x1005, writable=False)
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, which a SYNC would reach")
    return device.number(0x1005) & 0x7FF


def syncs(device: Device, can_id: int, pdo_id: int, count: int, first: int = 0) -> list[int]:
    """Send SYNCs, with a counter from `first` on where that is not zero; return how many PDOs came after each."""
    answers = []
    for number in range(count):
        since = device.wire.mark()
        device.wire.send(can_id, bytes(((first + number - 1) % OVERFLOW + 1,)) if first else b"")
        device.wire.listen(_ANSWER_S)
        answers.append(len(device.wire.heard(pdo_id, since)))
    return answers


@check("1019h does not take {}", "7.5.2.22", of=lambda device: [1, 241, 255])
def counter_range(device: Device, value: int) -> None:
    """Write a counter overflow that is none."""
    device.need(0x1019)
    device.expect_code(device.try_number(0x1019, 0, value), BAD_VALUE, f"{value} is refused")


@check("1019h does not change while the SYNC period 1006h is set", "7.5.2.22")
def counter_while_running(device: Device) -> None:
    """Set a period, then the counter; the node does not generate SYNC meanwhile."""
    device.need(0x1019)
    device.need(0x1006)
    device.write(0x1006, 0, 100_000)
    device.expect_code(device.try_number(0x1019, 0, OVERFLOW), (DEVICE_STATE, *NOT_NOW), "the overflow is refused")


@check("a PDO with a SYNC start value begins at that counter", "7.5.2.37")
def start_value(device: Device) -> None:
    """Start a PDO of type 2 at counter 4."""
    can_id = need_sync(device)
    device.need(0x1019)
    device.write(0x1019, 0, OVERFLOW)
    pdo_id = tpdo(device, 2, start=4)
    device.go_operational()
    answers = syncs(device, can_id, pdo_id, 8, first=1)
    device.expect(answers == [0, 0, 0, 1, 0, 1, 0, 1], "PDOs at counters 4, 6 and 8", device.wire.log[device.begun :][-16:])


@check("with a counter, a SYNC is obeyed that carries it", "7.2.5")
def with_counter(device: Device) -> None:
    """Send SYNCs with a counter to a PDO of type 1."""
    can_id = need_sync(device)
    device.need(0x1019)
    device.write(0x1019, 0, OVERFLOW)
    pdo_id = tpdo(device, 1)
    device.go_operational()
    device.expect(syncs(device, can_id, pdo_id, 3, first=1) == [1, 1, 1], "a PDO at every SYNC", device.wire.log[device.begun :][-8:])


@check("a SYNC with the identifier of 1005h is obeyed after that has changed, one with the old is not", "7.5.2.5")
def other_identifier(device: Device) -> None:
    """Move SYNC."""
    can_id = need_sync(device)
    device.need(0x1005)
    pdo_id = tpdo(device, 1)
    device.go_operational()
    device.write(0x1005, 0, 0x0A5)
    device.expect(syncs(device, 0x0A5, pdo_id, 2) == [1, 1], "a PDO at every SYNC of A5h")
    device.expect(can_id == 0x0A5 or syncs(device, can_id, pdo_id, 2) == [0, 0], f"no PDO at {can_id:03X}h")


@check("a node that does not generate SYNC sends none", "7.2.5")
def no_producer(device: Device) -> None:
    """Listen in operational."""
    can_id = need_sync(device)
    if device.number(0x1005) & 0x40000000:
        raise CheckSkippedError("the node generates SYNC (1005h bit 30)")
    since = device.go_operational()
    device.wire.listen(2 * QUIET_S)
    device.expect(not device.wire.heard(can_id, since), "silence", device.wire.heard(can_id, since))


@check("a node that generates SYNC sends it every {} ms", "7.5.2.6", of=lambda device: [20])
def producer(device: Device, period_ms: int) -> None:
    """Let the node generate SYNC."""
    can_id = need_sync(device)
    for index in (0x1005, 0x1006):
        device.need(index)
    device.write(0x1006, 0, 0)
    if device.try_number(0x1005, 0, 0x40000000 | can_id):
        raise CheckSkippedError("the device does not generate SYNC (1005h bit 30)")
    device.write(0x1006, 0, 1000 * period_ms)
    since = device.wire.mark()
    device.wire.listen(10.5e-3 * period_ms)
    frames = device.wire.heard(can_id, since)
    device.expect(9 <= len(frames) <= 11, f"ten SYNCs in {10 * period_ms} ms", frames[:4])
