"""Quirks of the SDO server: the length of its answers, and when they come."""

from __future__ import annotations

from collections import deque
from functools import partial

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.canopen.objects import Value, key_of
from virtual_bus.faults.machine import FaultyMachine, Frame
from virtual_bus.quirks.quirk import SDO_ANSWER, SDO_REQUEST, PutOn, Quirk, booted, says

EXPEDITED_UPLOAD, ITS_BITS = 0x43, 0xE3  # of the command byte: an answer of up to four bytes that says its length
NO_LENGTH = 0x42
LATE_S = 0.35
"""The report's device answers within 0.5 s, later than the 0.3 s that clients usually wait."""
SILENT_S = 2.0
"""As long as the report's drive takes."""
LEFT_OVER = b"0.0."  # what the report shows: the end of a text that was read before


def _expedited(command: int | None = None, rest: bytes | None = None) -> PutOn:
    """Return what changes command byte, or unused bytes, of expedited answers."""

    def put_on(machine: FaultyMachine, drive: Cia402Drive) -> None:
        def change(data: bytes) -> list[bytes]:
            if data[0] & ITS_BITS != EXPEDITED_UPLOAD:
                return [data]
            length = 4 - (data[0] >> 2 & 3)
            unused = data[4 + length :] if rest is None else rest[: 4 - length]
            return [bytes((data[0] if command is None else command,)) + data[1 : 4 + length] + unused]

        says(machine, drive, SDO_ANSWER, change)

    return put_on


def _late(machine: FaultyMachine, drive: Cia402Drive) -> None:
    waiting: deque[tuple[float, bytes]] = deque()
    own = SDO_ANSWER + drive.node_id

    def hold(data: bytes) -> list[bytes]:
        waiting.append((machine.time_s + LATE_S, data))
        return []

    def release() -> None:
        while waiting and machine.time_s >= waiting[0][0]:
            machine.put(own, waiting.popleft()[1])

    says(machine, drive, SDO_ANSWER, hold)
    machine.samples.add("", release)


def _silent_at_first(machine: FaultyMachine, drive: Cia402Drive) -> None:
    until_s = 0.0

    def boot() -> None:
        nonlocal until_s
        until_s = machine.time_s + SILENT_S

    def hear(can_id: int, data: bytes) -> Frame | None:
        return None if can_id == SDO_REQUEST + drive.node_id and machine.time_s < until_s else (can_id, data)

    booted(machine, drive, boot)
    machine.heard.add(drive.node_id, hear)


def refuse(code: int, value: Value = 0) -> Value:
    """Refuse a transfer."""
    raise SdoAbortError(code)


def lacks(index: int, subindex: int = 0, *, code: int = abort.NO_OBJECT) -> PutOn:
    """Return what takes an object that its data sheet has out of a drive's SDO server."""

    def put_on(machine: FaultyMachine, drive: Cia402Drive) -> None:
        def check(value: Value) -> None:
            refuse(code, value)

        drive.objects.readings[key_of(index, subindex)] = partial(refuse, code)
        drive.objects.checks[key_of(index, subindex)] = check

    return put_on


QUIRKS = (
    Quirk("sdo_four_bytes", "It answers every expedited SDO upload with four bytes, whatever the object's size.", "SDO",
          "https://github.com/canopen-python/canopen/pull/395", _expedited(EXPEDITED_UPLOAD)),
    Quirk("sdo_no_length", "Its expedited SDO answers do not say how many of the four bytes count.", "SDO",
          "https://github.com/canopen-python/canopen/issues/64", _expedited(NO_LENGTH)),
    Quirk("sdo_left_overs", "The bytes of an SDO answer that do not count hold what is left of an earlier one.", "SDO",
          "https://github.com/CANopenNode/CANopenNode/issues/345", _expedited(rest=LEFT_OVER)),
    Quirk("sdo_late", "It answers SDOs after 0.35 s, when clients have asked again.", "SDO",
          "https://github.com/canopen-python/canopen/issues/25", _late),
    Quirk("sdo_silent_at_first", "It answers no SDO for 2 s after its boot-up message.", "SDO",
          "https://github.com/canopen-python/canopen/issues/401", _silent_at_first),
    Quirk("modes_unlisted", "It lacks the list of its modes (6502h).", "SDO",
          "https://github.com/ros-industrial/ros2_canopen/issues/299", lacks(0x6502)),
    Quirk("no_rpdo_timer", "It lacks the event timer of its RPDOs (1400h:05), which its data sheet has.", "SDO",
          "https://github.com/canopen-python/canopen/issues/283", lacks(0x1400, 5, code=abort.NO_SUBINDEX)),
)  # fmt: skip
