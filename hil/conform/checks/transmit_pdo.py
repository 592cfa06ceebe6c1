"""Transmit PDOs: when each transmission type sends, and inhibit and event times."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from statistics import mean

from canopen.objectdictionary import ODVariable

from hil.conform.check import Checks, CheckSkippedError
from hil.conform.checks.error_control import TOLERANCE, intervals
from hil.conform.checks.sync import need_sync, syncs
from hil.conform.device import Device, Pdo
from hil.conform.pdo_setup import first_tpdos, mapped_of, mapping_of, one, set_up, silence_others, tpdo
from hil.conform.wire import QUIET_S

CHECKS = Checks("transmit PDOs")
check = CHECKS.check
_EVENT_MS, _INHIBIT_MS = 40, 100
_SOME = 8


@check("transmission type {} sends at every {}th SYNC", "7.5.2.37", of=lambda device: [1, 2, 3, 5])
def cyclic(device: Device, kind: int) -> None:
    """Send SYNCs."""
    can_id = need_sync(device)
    pdo_id = tpdo(device, kind)
    device.go_operational()
    count = 3 * kind
    answers = syncs(device, can_id, pdo_id, count)
    device.expect(
        sum(answers) == 3 and max(answers) == 1, f"3 PDOs at {count} SYNCs, not {sum(answers)}", device.wire.log[device.begun :][-8:]
    )
    places = [place for place, number in enumerate(answers) if number]
    device.expect({b - a for a, b in pairwise(places)} == {kind}, f"one PDO in {kind} SYNCs, evenly")


@check("transmission type 240 does not send at the first SYNCs", "7.5.2.37")
def rare(device: Device) -> None:
    """Send three SYNCs to a PDO of every 240th."""
    can_id = need_sync(device)
    pdo_id = tpdo(device, 240)
    device.go_operational()
    device.expect(sum(syncs(device, can_id, pdo_id, 3)) == 0, "no PDO before the 240th SYNC")


@check("transmission type 0 sends after a SYNC, and not again without an event", "7.5.2.37")
def acyclic(device: Device) -> None:
    """Send SYNCs while nothing changes."""
    can_id = need_sync(device)
    mapped = [mapping_of(_steady(device))]
    pdo_id = tpdo(device, 0, mapped)
    since = device.go_operational()
    device.expect(not device.wire.heard(pdo_id, since), "no PDO before a SYNC", device.wire.heard(pdo_id, since))
    answers = syncs(device, can_id, pdo_id, 4)
    device.expect(answers[1:] == [0, 0, 0] and answers[0] <= 1, "no PDO without an event", device.wire.log[device.begun :][-8:])


def _steady(device: Device) -> ODVariable:
    """Return an object that does not change by itself and can be sent."""
    try:
        return device.spare_object()
    except CheckSkippedError:
        for entry in device.entries:
            if entry.pdo_mappable and entry.readable and len(entry) in (8, 16, 32) and entry.index in (0x1001, 0x6061, 0x6502):
                return entry
    raise CheckSkippedError("no object that stays as it is can be mapped")


@check("transmission type 0 sends an event at the SYNC that follows it", "7.5.2.37", writes=True)
def acyclic_event(device: Device) -> None:
    """Change what is mapped."""
    can_id = need_sync(device)
    entry = device.spare_object()
    pdo_id = tpdo(device, 0, [mapping_of(entry)])
    device.go_operational()
    syncs(device, can_id, pdo_id, 2)
    since = device.wire.mark()
    _change(device, 1)
    device.wire.listen(QUIET_S)
    device.expect(not device.wire.heard(pdo_id, since), "no PDO before the SYNC", device.wire.heard(pdo_id, since))
    device.expect(syncs(device, can_id, pdo_id, 2) == [1, 0], "one PDO at the SYNC")


def _change(device: Device, by: int) -> bytes:
    """Give the spare object another value; return it."""
    entry = device.spare_object()
    size = len(entry) // 8
    old = int.from_bytes(device.read(entry.index, entry.subindex), "little")
    new = (old ^ by).to_bytes(size, "little")
    device.expect(device.try_write(entry.index, entry.subindex, new) == 0, f"{entry.index:04X}h takes {new.hex()}")
    return new


@check("transmission type {} does not send at a SYNC", "7.5.2.37", of=lambda device: [254, 255])
def event_driven(device: Device, kind: int) -> None:
    """Send SYNCs to an event-driven PDO."""
    can_id = need_sync(device)
    pdo_id = tpdo(device, kind, [mapping_of(_steady(device))])
    device.go_operational()
    device.wire.listen(QUIET_S)
    device.expect(sum(syncs(device, can_id, pdo_id, 3)) == 0, "no PDO", device.wire.log[device.begun :][-8:])


@check("transmission type {} with an event time of 40 ms sends every 40 ms", "7.5.2.37", of=lambda device: [254, 255])
def event_time(device: Device, kind: int) -> None:
    """Measure the mean period."""
    pdo_id = tpdo(device, kind, [mapping_of(_steady(device))], event=_EVENT_MS)
    device.go_operational()
    device.wire.wait(pdo_id, 0.5)
    since = device.wire.mark()
    device.wire.listen((_SOME + 0.5) * 1e-3 * _EVENT_MS)
    frames = device.wire.heard(pdo_id, since)
    device.expect(len(frames) > 2, f"a PDO every {_EVENT_MS} ms", frames[:4])
    found = 1e3 * mean(intervals(frames))
    device.expect(abs(found - _EVENT_MS) <= TOLERANCE * _EVENT_MS, f"every {_EVENT_MS} ms, not {found:.1f} ms", frames[:4])


@check("transmission type {} sends when a mapped value changes", "7.5.2.37", of=lambda device: [254, 255], writes=True)
def on_change(device: Device, kind: int) -> None:
    """Change what is mapped."""
    entry = device.spare_object()
    pdo_id = tpdo(device, kind, [mapping_of(entry)])
    device.go_operational()
    device.wire.listen(QUIET_S)
    since = device.wire.mark()
    new = _change(device, 1)
    device.wire.listen(QUIET_S)
    frames = device.wire.heard(pdo_id, since)
    if not frames and kind == 254:
        raise CheckSkippedError("the events of type 254 are the manufacturer's")
    if not frames:
        raise CheckSkippedError("the events of this object are its profile's")
    device.expect(frames[-1].data == new, f"the new value {new.hex(' ').upper()}, low byte first", frames)


@check("an inhibit time of 100 ms keeps PDOs so far apart, and no further", "7.5.2.37", writes=True)
def inhibit(device: Device) -> None:
    """Change what is mapped faster than that."""
    entry = device.spare_object()
    pdo_id = tpdo(device, 255, [mapping_of(entry)], inhibit=10 * _INHIBIT_MS)
    device.go_operational()
    device.wire.listen(2e-3 * _INHIBIT_MS)
    since = device.wire.mark()
    for step in range(20):
        _change(device, step % 2 + 1)
        device.wire.listen(0.02)
    frames = device.wire.heard(pdo_id, since)
    if not frames:
        raise CheckSkippedError("the events of this object are its profile's")
    apart = intervals(frames)
    shortest = 1e3 * min(apart, default=0.0)
    device.expect(shortest >= (1 - TOLERANCE) * _INHIBIT_MS, f"at least {_INHIBIT_MS} ms between PDOs, not {shortest:.1f} ms", frames[:4])
    longest = 1e3 * max(apart)
    device.expect(longest <= _INHIBIT_MS + 50, f"a waiting event is sent after {_INHIBIT_MS} ms, not {longest:.0f} ms", frames[:4])


@check("an event time that is shorter than the inhibit time waits for it", "7.5.2.37")
def inhibited_events(device: Device) -> None:
    """Set an event time of 40 ms beside an inhibit time of 100 ms."""
    pdo_id = tpdo(device, 255, [mapping_of(_steady(device))], event=_EVENT_MS, inhibit=10 * _INHIBIT_MS)
    device.go_operational()
    device.wire.wait(pdo_id, 0.5)
    since = device.wire.mark()
    device.wire.listen(0.5)
    frames = device.wire.heard(pdo_id, since)
    device.expect(len(frames) >= 2, "PDOs")
    shortest = 1e3 * min(intervals(frames))
    device.expect(shortest >= (1 - TOLERANCE) * _INHIBIT_MS, f"at least {_INHIBIT_MS} ms between PDOs, not {shortest:.1f} ms", frames[:4])


def _mapped_pdos(device: Device) -> Iterable[Pdo]:
    return first_tpdos(device)


@check("{} carries its mapped objects in their order, low byte first", "7.5.2.38", of=_mapped_pdos)
def content(device: Device, pdo: Pdo) -> None:
    """Compare a PDO with its objects read over SDO."""
    can_id = need_sync(device)
    mapped = mapped_of(device, pdo)
    if not mapped or any(value & 7 for value in mapped):
        raise CheckSkippedError("nothing of whole bytes is mapped")
    device.need(pdo.communication, 1)
    silence_others(device, pdo)
    pdo_id = set_up(device, pdo, 1)
    device.go_operational()
    before = _values(device, mapped)
    device.wire.send(can_id)
    frame = device.wire.wait(pdo_id, 0.5)
    device.expect(frame is not None, f"a PDO with {pdo_id:03X}h")
    assert frame is not None
    device.expect(len(frame.data) == len(before), f"{len(before)} bytes", [frame])
    after = _values(device, mapped)
    if before == after:
        device.expect(frame.data == before, f"{before.hex(' ').upper()}, as read over SDO", [frame])


def _values(device: Device, mapped: list[int]) -> bytes:
    return b"".join(device.read(value >> 16, value >> 8 & 0xFF) for value in mapped)


@check("a TPDO that is off sends nothing", "7.5.2.37")
def off(device: Device) -> None:
    """Switch a PDO off and send SYNCs."""
    can_id = need_sync(device)
    pdo = one(device, receive=False)
    pdo_id = tpdo(device, 1)
    device.write(pdo.communication, 1, device.number(pdo.communication, 1) | 1 << 31)
    device.go_operational()
    device.expect(sum(syncs(device, can_id, pdo_id, 3)) == 0, "no PDO")
