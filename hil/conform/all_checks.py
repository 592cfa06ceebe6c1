"""All checks of one node, one after the other; the node is left as it was found."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import can
import canopen

from drivers.canopen.network import HEARTBEAT, NMT_PRE_OPERATIONAL, NMT_RESET_NODE, SDO_REQUEST, SDO_RESPONSE
from hil.conform.check import FAILED, PASSED, SKIPPED, Check, CheckFailedError, CheckSkippedError, Result
from hil.conform.checks import ALL
from hil.conform.device import OPERATIONAL, Device
from hil.conform.put_back import put_back, values_of
from hil.conform.transfers import head
from hil.conform.wire import Wire
from hil.errors import UnusableInputError

LISTEN_S = 0.6
"""How long to listen before anything is sent: for other masters, and for nodes that have a heartbeat."""
_STATUSWORD, _STATE_BITS = 0x6041, 0x6F
_VOLTAGE = {0x23: "switched on", 0x27: "operation enabled", 0x07: "quick stop active", 0x0F: "fault reaction active"}
_NMT, _SYNC = 0x000, 0x080
_WRITES = "alters stored or application parameters: give --writes"


@dataclass(frozen=True)
class Conformance:
    """What came of all checks of one node."""

    node_id: int
    results: tuple[Result, ...]
    not_restored: tuple[str, ...]
    others: tuple[int, ...]
    seconds: float

    def count(self, result: str) -> int:
        """Return how many checks ended so."""
        return sum(1 for one in self.results if one.result == result)


def conform(
    bus: can.BusABC,
    now: Callable[[], float],
    node_id: int,
    dictionary: canopen.ObjectDictionary,
    *,
    writes: bool = False,
    follow: Callable[[int, int], None] = lambda done, of: None,
    until_failed: bool = False,
) -> Conformance:
    """Check one node.

    Parameters
    ----------
    bus : can.BusABC
        Open; it stays open.
    now : callable
        Time [s] on that bus.
    node_id : int
    dictionary : canopen.ObjectDictionary
        Of its data sheet, read for this node id.
    writes : bool
        Make also the checks that alter stored and application parameters.
    follow : callable
        Called after every check with how many are done, and of how many.
    until_failed : bool
        End with the first check that fails.

    Raises
    ------
    UnusableInputError
        The node does not answer, its power stage is on, or another master is on the bus.
    BusError
        The bus cannot be used.
    """
    began_s = time.perf_counter()
    wire = Wire(bus, now, node_id)
    found, told = _look_around(wire)
    device = Device(wire, dictionary, writes=writes, others=bool(found))
    _refuse_what_is_unsafe(device)
    before = values_of(device, device.parameters())  # the reset of the node takes what is not stored
    device.reset()
    planned = list(_planned(device))
    results: list[Result] = []
    try:
        for check, target in planned:
            results.append(_made(device, check, target))
            follow(len(results), len(planned))
            if until_failed and results[-1].result == FAILED:
                break
            if results[-1].result == FAILED and not _still_there(device):
                results += [_result(c, t, SKIPPED, reason="the node no longer answers") for c, t in planned[len(results) :]]
                break
    finally:
        device.reset()
        lost = [*device.not_restored, *put_back(device, before)]
    if told == OPERATIONAL:
        lost.append("it was operational and is pre-operational now")
    return Conformance(node_id, tuple(results), tuple(dict.fromkeys(lost)), found, time.perf_counter() - began_s)


def _look_around(wire: Wire) -> tuple[tuple[int, ...], int]:
    """Return the other nodes on the bus, and the state that the node told, -1 for none."""
    wire.listen(LISTEN_S)
    for can_id, who in ((_SYNC, "SYNC"), (_NMT, "NMT commands")):
        if wire.heard(can_id):
            raise UnusableInputError(
                f"somebody else sends {who} on this bus ({can_id:03X}h): end it first; checks and a running master do not mix"
            )
    told = [frame.data[0] & 0x7F for frame in wire.heard(HEARTBEAT + wire.node_id) if frame.data]
    for node_id in range(1, 128):
        if node_id != wire.node_id:
            wire.send(SDO_REQUEST + node_id, head(0x40, 0x1000, 0))
    wire.listen(0.2)
    ids = {
        frame.can_id - base
        for base in (SDO_RESPONSE, HEARTBEAT)
        for frame in wire.log
        if not frame.sent and base < frame.can_id < base + 128
    }
    wire.log.clear()
    return tuple(sorted(ids - {wire.node_id})), told[-1] if told else -1


def _refuse_what_is_unsafe(device: Device) -> None:
    if not device.is_there():
        device.nmt(NMT_PRE_OPERATIONAL)  # it may be stopped
        if not device.is_there():
            raise UnusableInputError(
                f"node {device.node_id} does not answer: is it powered, on this bus, and this its id? `isocenter scan-bus` tells"
            )
    if device.entry(_STATUSWORD) is None:
        return
    word = device.try_read(_STATUSWORD)
    state = _VOLTAGE.get(int.from_bytes(word, "little") & _STATE_BITS) if isinstance(word, bytes) else None
    if state is not None:
        raise UnusableInputError(
            f"node {device.node_id}: its power stage is on ({state}); secure the axis and switch it off: the checks reset the node"
        )


def _planned(device: Device) -> Iterator[tuple[Check, object]]:
    for check in ALL:
        if check.of is None:
            yield check, None
        else:
            for target in check.of(device):
                yield check, target


def _result(check: Check, target: object, result: str, **more: object) -> Result:
    words = (
        check.words if target is None else check.words.replace("{}", str(target)) if "{}" in check.words else f"{check.words} ({target})"
    )
    return Result(check.group, words.replace("{}", "each"), check.clause, result, **more)  # type: ignore[arg-type]


def _made(device: Device, check: Check, target: object) -> Result:
    """Make one check, and put back what it has changed."""
    if check.writes and not device.writes:
        return _result(check, target, SKIPPED, reason=_WRITES)
    device.begin()
    arguments: Sequence[object] = () if target is None else (target,)
    try:
        check.run(device, *arguments)
    except CheckFailedError as failure:
        return _result(check, target, FAILED, expected=failure.expected, frames=failure.frames)
    except CheckSkippedError as skipped:
        return _result(check, target, SKIPPED, reason=str(skipped))
    else:
        return _result(check, target, PASSED)
    finally:
        device.restore()


def _still_there(device: Device) -> bool:
    """Return whether the node answers, after a reset if need be."""
    if device.is_there():
        return True
    device.reset(NMT_RESET_NODE)
    return device.is_there()
