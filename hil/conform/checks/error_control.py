"""Error control: heartbeat, node guarding and life guarding, and the heartbeat consumer."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from statistics import mean

from drivers.canopen.network import HEARTBEAT, NMT_START, NMT_STOP
from hil.conform.aborts import BAD_VALUE, INCOMPATIBLE, NOT_NOW
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import OPERATIONAL, PRE_OPERATIONAL, STOPPED, Device
from hil.conform.wire import QUIET_S, Frame

CHECKS = Checks("error control")
check = CHECKS.check
TOLERANCE = 0.1
"""Share by which a mean period may differ. CiA 301 names none; crystal clocks are a thousand times better."""
_BEATS = 6
_LIFE_MS, _LIFE_FACTOR = 50, 3
CONSUMED_MS = 150
LATE_S = 0.15  # a report may be so late
LOST = b"\x30\x81"  # EMCY 8130h: life guard error or heartbeat error


def intervals(frames: Sequence[Frame]) -> list[float]:
    """Return the times between frames [s]."""
    return [later.time_s - earlier.time_s for earlier, later in pairwise(frames)]


@check("a heartbeat of {} ms comes every {} ms", "7.2.8.3.2.2", of=lambda device: [20, 50, 200])
def period(device: Device, milliseconds: int) -> None:
    """Measure the mean period."""
    device.need(0x1017)
    device.write(0x1017, 0, milliseconds)
    device.wire.wait(HEARTBEAT + device.node_id, 1.0)
    since = device.wire.mark()
    device.wire.listen((_BEATS + 0.5) * 1e-3 * milliseconds)
    frames = device.wire.heard(HEARTBEAT + device.node_id, since)
    device.expect(len(frames) >= 2, f"a heartbeat every {milliseconds} ms", frames[:4])
    found = 1e3 * mean(intervals(frames))
    device.expect(abs(found - milliseconds) <= TOLERANCE * milliseconds, f"every {milliseconds} ms, not {found:.1f} ms", frames[:4])


@check("a heartbeat time of 0 ends the heartbeat", "7.5.2.20")
def none(device: Device) -> None:
    """Switch it on and off."""
    device.need(0x1017)
    device.write(0x1017, 0, 20)
    device.expect(device.wire.wait(HEARTBEAT + device.node_id, 0.5) is not None, "a heartbeat")
    device.write(0x1017, 0, 0)
    since = device.wire.mark()
    device.wire.listen(2 * QUIET_S)
    device.expect(not device.wire.heard(HEARTBEAT + device.node_id, since), "silence", device.wire.heard(HEARTBEAT + device.node_id, since))


@check("a heartbeat has one byte, the state", "7.2.8.3.2.2")
def one_byte(device: Device) -> None:
    """Look at a heartbeat."""
    device.need(0x1017)
    device.write(0x1017, 0, 20)
    frame = device.wire.wait(HEARTBEAT + device.node_id, 0.5)
    device.expect(frame is not None and frame.data == bytes((PRE_OPERATIONAL,)), "7F")


# ---- guarding -----------------------------------------------------------------------------------------
def _need_guarding(device: Device) -> None:
    device.need(0x100C, writable=False)
    if (entry := device.entry(0x1017)) is not None and entry.writable:
        device.write(0x1017, 0, 0)


def _guard(device: Device) -> Frame | None:
    device.wire.send(HEARTBEAT + device.node_id, remote=True)
    return device.wire.wait(HEARTBEAT + device.node_id, 0.2)


@check("guarding is answered with the state, and a toggle bit that alternates from 0", "7.2.8.3.2.1")
def guarding(device: Device) -> None:
    """Ask by remote frames."""
    _need_guarding(device)
    device.reset()
    _need_guarding(device)
    for toggle in (0, 1, 0, 1):
        frame = _guard(device)
        device.expect(frame is not None and frame.data == bytes((PRE_OPERATIONAL | toggle << 7,)), f"{PRE_OPERATIONAL | toggle << 7:02X}")
    device.must_reset()
    for toggle, (command, state) in enumerate(((NMT_STOP, STOPPED), (NMT_START, OPERATIONAL))):
        device.nmt(command)
        frame = _guard(device)
        device.expect(frame is not None and frame.data == bytes((state | toggle << 7,)), f"{state | toggle << 7:02X}")


@check("a reset of the communication clears guarding's toggle bit", "7.2.8.3.2.1")
def guarding_reset(device: Device) -> None:
    """Ask once, reset, ask again."""
    _need_guarding(device)
    device.reset()
    _need_guarding(device)
    _guard(device)
    device.reset()
    _need_guarding(device)
    frame = _guard(device)
    device.expect(frame is not None and frame.data == b"\x7f", "7F")


@check("with a heartbeat, guarding is not used", "7.2.8.3.2.2")
def heartbeat_wins(device: Device) -> None:
    """Ask while the heartbeat runs."""
    _need_guarding(device)
    device.need(0x1017)
    device.write(0x1017, 0, 200)
    device.wire.wait(HEARTBEAT + device.node_id, 0.5)
    since = device.wire.mark()
    device.wire.send(HEARTBEAT + device.node_id, remote=True)
    device.wire.listen(QUIET_S)
    device.expect(not device.wire.heard(HEARTBEAT + device.node_id, since), "silence until the next heartbeat")


@check("a guarding master that stays away is reported after guard time times life time factor", "7.2.8.2.2.2")
def life_guarding(device: Device) -> None:
    """Ask, then stay away."""
    _need_guarding(device)
    device.write(0x100C, 0, _LIFE_MS)
    device.write(0x100D, 0, _LIFE_FACTOR)
    _guard(device)
    since = device.wire.mark()
    _expect_lost(device, since, 1e-3 * _LIFE_MS * _LIFE_FACTOR)
    frame = _guard(device)
    device.expect(frame is not None, "guarding is answered again")


def _expect_lost(device: Device, since: int, after_s: float) -> None:
    """Expect EMCY 8130h so much later."""
    can_id = emergency_id(device)
    begun_s = device.wire.now()
    device.wire.listen(0.8 * after_s)
    device.expect(not device.wire.heard(can_id, since), f"no EMCY before {after_s:g} s", device.wire.heard(can_id, since))
    device.wire.listen(begun_s + after_s + LATE_S - device.wire.now())
    frames = [frame for frame in device.wire.heard(can_id, since) if frame.data[:2] == LOST]
    device.expect(bool(frames), f"EMCY 8130h ({can_id:03X} 30 81) within {after_s + LATE_S:g} s")
    register = frames[0].data[2]
    device.expect(register & 0x11 == 0x11, "error register with bits 0 and 4 (generic, communication)", frames)


def emergency_id(device: Device) -> int:
    """Return the identifier of emergency messages; skip the check where the node has none."""
    device.need(0x1014, writable=False)
    value = device.number(0x1014)
    if value >> 31:
        raise CheckSkippedError("emergency messages are switched off (1014h bit 31)")
    return value & 0x7FF


# ---- consumer -----------------------------------------------------------------------------------------
def producer_id(device: Device) -> int:
    """Return the node id whose heartbeat the tester sends."""
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, one of which may have the id of the heartbeat that is sent")
    return 0x7E if device.node_id != 0x7E else 0x7D


def consume(device: Device) -> int:
    """Let the node supervise the tester; return the identifier of the tester's heartbeat."""
    device.need(0x1016, 1)
    node_id = producer_id(device)
    device.write(0x1016, 1, node_id << 16 | CONSUMED_MS)
    return HEARTBEAT + node_id


def beat(device: Device, can_id: int, times: int = 3) -> None:
    """Send heartbeats."""
    for _ in range(times):
        device.wire.send(can_id, bytes((OPERATIONAL,)))
        device.wire.listen(0.3e-3 * CONSUMED_MS)


def lose(device: Device, can_id: int) -> int:
    """Send heartbeats, stay away for longer than the consumer's time; return the log's place where that began."""
    beat(device, can_id)
    since = device.wire.mark()
    device.wire.listen(1e-3 * CONSUMED_MS + LATE_S)
    return since


@check("a heartbeat that stays away is reported after the consumer's time", "7.2.8.2.2.3")
def consumer(device: Device) -> None:
    """Be supervised, and fall silent."""
    can_id = consume(device)
    beat(device, can_id)
    since = device.wire.mark()
    _expect_lost(device, since, 1e-3 * CONSUMED_MS * 0.7)  # the last beat is some time ago


@check("a heartbeat that never came is not missed", "7.2.8.2.2.3")
def consumer_begins(device: Device) -> None:
    """Be supervised, and never send one."""
    can_id = emergency_id(device)
    consume(device)
    since = device.wire.mark()
    device.wire.listen(1e-3 * CONSUMED_MS + LATE_S)
    device.expect(not device.wire.heard(can_id, since), "no EMCY", device.wire.heard(can_id, since))


@check("two entries of 1016h do not take the same node id", "7.5.2.19")
def consumer_twice(device: Device) -> None:
    """Write a node id twice."""
    device.need(0x1016, 2)
    consume(device)
    code = device.try_number(0x1016, 2, producer_id(device) << 16 | 2 * CONSUMED_MS)
    device.expect_code(code, (INCOMPATIBLE,), "the second is refused")


_BEHAVIOURS = {0: PRE_OPERATIONAL, 1: OPERATIONAL, 2: STOPPED}


@check("1029h:01 = {} decides the state after a communication error in operational", "7.5.2.32", of=lambda device: list(_BEHAVIOURS))
def error_behaviour(device: Device, value: int) -> None:
    """Fall silent towards a node in operational."""
    if not device.has_object(0x1029):
        device.need(0x1016, 1)
        if value:
            raise CheckSkippedError("the data sheet has no 1029h, so the behaviour is that of 0")
    else:
        device.need(0x1029, 1)
        if (code := device.try_number(0x1029, 1, value)) and value:
            device.expect(code > 0, "an answer")
            raise CheckSkippedError(f"1029h:01 does not take {value}")
    can_id = consume(device)
    device.watch_state()
    device.must_reset()
    device.nmt(NMT_START)
    lose(device, can_id)
    told = device.state()
    device.expect(told == _BEHAVIOURS[value], f"state {_BEHAVIOURS[value]:02X}h")


@check("1029h:01 does not take {}, which is reserved", "7.5.2.32", of=lambda device: [3, 0x7F])
def error_behaviour_range(device: Device, value: int) -> None:
    """Write a reserved value."""
    device.need(0x1029, 1)
    device.expect_code(device.try_number(0x1029, 1, value), (*BAD_VALUE, *NOT_NOW), "the value is refused")
