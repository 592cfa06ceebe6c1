"""Network management: states, what each of them permits, and boot-up."""

from __future__ import annotations

from drivers.canopen.network import (
    HEARTBEAT,
    NMT_PRE_OPERATIONAL,
    NMT_RESET_COMMUNICATION,
    NMT_RESET_NODE,
    NMT_START,
    NMT_STOP,
    SDO_REQUEST,
    SDO_RESPONSE,
)
from hil.conform.check import Checks, CheckSkippedError
from hil.conform.device import BOOT_S, INVALID, OPERATIONAL, PRE_OPERATIONAL, STOPPED, Device
from hil.conform.pdo_setup import tpdo
from hil.conform.transfers import head
from hil.conform.wire import QUIET_S

CHECKS = Checks("network management")
check = CHECKS.check
_STATES = {"start": (NMT_START, OPERATIONAL), "stop": (NMT_STOP, STOPPED), "enter pre-operational": (NMT_PRE_OPERATIONAL, PRE_OPERATIONAL)}
_NAMES = {OPERATIONAL: "05h, operational", STOPPED: "04h, stopped", PRE_OPERATIONAL: "7Fh, pre-operational"}
_RESETS = {"reset node": NMT_RESET_NODE, "reset communication": NMT_RESET_COMMUNICATION}


def _expect_state(device: Device, state: int) -> None:
    told = device.state()
    device.expect(told == state, f"state {_NAMES[state]}")


@check("after {}, a boot-up message comes, and the node is pre-operational", "7.2.8.3.3", of=lambda device: list(_RESETS))
def boot_up(device: Device, which: str) -> None:
    """Reset the node."""
    frame = device.reset(_RESETS[which])
    device.must_reset()
    device.expect(frame is not None, f"{HEARTBEAT + device.node_id:03X} 00 within {BOOT_S:g} s")
    device.expect(device.is_alive(), "the SDO server answers")
    device.watch_state()
    _expect_state(device, PRE_OPERATIONAL)


def _changes(device: Device) -> list[str]:
    return [f"{second} after {first}" for first in _STATES for second in _STATES if first != second]


@check("{} is obeyed", "7.3.2.2", of=_changes)
def change(device: Device, which: str) -> None:
    """Go through two states."""
    second, first = which.split(" after ")
    device.must_reset()
    device.watch_state()
    for name in (first, second):
        device.nmt(_STATES[name][0])
        _expect_state(device, _STATES[name][1])


@check("reset communication out of {} gives a boot-up message", "7.3.2.2", of=lambda device: ["operational", "stopped"])
def reset_from(device: Device, which: str) -> None:
    """Reset out of other states."""
    device.must_reset()
    device.nmt(NMT_START if which == "operational" else NMT_STOP)
    device.wire.listen(QUIET_S)
    device.expect(device.reset() is not None, f"{HEARTBEAT + device.node_id:03X} 00 within {BOOT_S:g} s")


@check("a command to another node is not obeyed", "7.2.8.3.1", of=lambda device: list(_STATES)[:2])
def foreign_command(device: Device, which: str) -> None:
    """Command a node id that nobody has."""
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, one of which would obey")
    device.must_reset()
    device.watch_state()
    _expect_state(device, PRE_OPERATIONAL)
    device.nmt(_STATES[which][0], device.node_id % 127 + 1)
    _expect_state(device, PRE_OPERATIONAL)


@check("{}, sent to all nodes, is obeyed", "7.2.8.3.1", of=lambda device: [*_STATES, "reset communication"])
def broadcast(device: Device, which: str) -> None:
    """Command node id 0."""
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, which would obey, too")
    device.must_reset()
    device.watch_state()
    if which == "reset communication":
        since = device.wire.mark()
        device.nmt(NMT_RESET_COMMUNICATION, 0)
        device.wire.listen(0.5)
        told = [frame.data for frame in device.wire.heard(HEARTBEAT + device.node_id, since)]
        device.expect(b"\0" in told, f"{HEARTBEAT + device.node_id:03X} 00 within 0.5 s")
        return
    if which == "enter pre-operational":
        device.nmt(NMT_START)
        _expect_state(device, OPERATIONAL)
    device.nmt(_STATES[which][0], 0)
    _expect_state(device, _STATES[which][1])


@check("a command that is none changes nothing", "7.2.8.3.1", of=lambda device: ["03h", "7Fh", "FFh"])
def unknown_command(device: Device, which: str) -> None:
    """Send a command specifier that does not exist."""
    device.must_reset()
    device.watch_state()
    device.nmt(int(which[:2], 16))
    _expect_state(device, PRE_OPERATIONAL)


@check("the SDO server answers in {}", "7.3.2.2", of=lambda device: ["pre-operational", "operational"])
def sdo_permitted(device: Device, which: str) -> None:
    """Read where it is permitted."""
    device.must_reset()
    device.nmt(NMT_START if which == "operational" else NMT_PRE_OPERATIONAL)
    device.expect(device.is_alive(), "an answer")


@check("the SDO server does not answer in stopped", "7.3.2.2")
def sdo_forbidden(device: Device) -> None:
    """Read where it is not permitted."""
    device.must_reset()
    device.nmt(NMT_STOP)
    since = device.wire.mark()
    device.wire.send(SDO_REQUEST + device.node_id, head(0x40, 0x1000, 0))
    device.wire.listen(QUIET_S)
    device.expect(
        not device.wire.heard(SDO_RESPONSE + device.node_id, since), "silence", device.wire.heard(SDO_RESPONSE + device.node_id, since)
    )


@check("no PDO is sent in {}", "7.3.2.2", of=lambda device: ["pre-operational", "stopped"])
def pdo_forbidden(device: Device, which: str) -> None:
    """Send SYNCs where a PDO is not permitted."""
    _need_sync(device)
    can_id = tpdo(device, 1)
    sync_id = device.number(0x1005) & 0x7FF
    device.must_reset()
    if which == "stopped":
        device.nmt(NMT_STOP)
    since = device.wire.mark()
    for _ in range(3):
        device.wire.send(sync_id)
        device.wire.listen(QUIET_S / 3)
    device.expect(not device.wire.heard(can_id, since), "silence", device.wire.heard(can_id, since))


def _need_sync(device: Device) -> None:
    device.need(0x1005, writable=False)
    if device.others:
        raise CheckSkippedError("other nodes are on the bus, which a SYNC would reach")


@check("a PDO answers a SYNC in operational", "7.3.2.2")
def pdo_permitted(device: Device) -> None:
    """Send a SYNC where a PDO is permitted."""
    _need_sync(device)
    can_id = tpdo(device, 1)
    sync_id = device.number(0x1005) & 0x7FF
    device.go_operational()
    device.wire.send(sync_id)
    device.expect(device.wire.wait(can_id, 0.5) is not None, f"a PDO with {can_id:03X}h")


@check("a reset of the communication gives 1017h its power-on value again", "7.3.2.2.1")
def reset_restores(device: Device) -> None:
    """Write 1017h, and reset."""
    device.need(0x1017)
    before = device.number(0x1017)
    device.write(0x1017, 0, before ^ 0x0100)
    device.expect(device.reset() is not None, f"{HEARTBEAT + device.node_id:03X} 00")
    device.expect(device.number(0x1017) == before, f"1017h holds {before:04X}h again")


@check("a reset of the communication gives {}:01 its power-on value again", "7.3.2.2.1", of=lambda device: device.pdos(receive=False)[:1])
def reset_restores_pdo(device: Device, pdo: object) -> None:
    """Switch a PDO off or on, and reset."""
    index = int(str(pdo)[:4], 16)
    device.need(index, 1)
    before = device.number(index, 1)
    device.write(index, 1, before ^ INVALID)
    device.expect(device.reset() is not None, f"{HEARTBEAT + device.node_id:03X} 00")
    device.expect(device.number(index, 1) == before, f"{pdo}:01 holds {before:08X}h again")
