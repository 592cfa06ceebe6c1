"""The declaration of a quirk: its name, what the drive does, where that was reported, and how it is put on an emulated drive.

A fault begins and ends; a quirk is how the drive is built, from power-on. Both act at the seams of `FaultyMachine`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.canopen.nmt import NmtCommand
from virtual_bus.canopen.objects import Entry, Value, key_of
from virtual_bus.faults.machine import FaultyMachine, Frame
from virtual_bus.faults.pdo_ids import rpdos

PutOn = Callable[[FaultyMachine, Cia402Drive], None]
Group = Literal["network", "SDO", "EMCY", "states", "modes", "homing", "units"]

NMT, EMERGENCY, SDO_ANSWER, SDO_REQUEST, ERROR_CONTROL = 0x000, 0x080, 0x580, 0x600, 0x700  # plus node id
BOOT_UP = b"\x00"
CONTROLWORD, STATUSWORD, MODE, MODE_DISPLAY = 0x6040, 0x6041, 0x6060, 0x6061


@dataclass(frozen=True)
class Quirk:
    """One way in which a drive bends the standard.

    Parameters
    ----------
    name : str
    does : str
        In a sentence.
    group : str
        Of what it is.
    source : str
        Address of a report, a maker's manual or a maintainer's answer.
    put_on : callable
        Puts it on a drive of a machine that is not yet powered on.
    shown_by : str
        A fault without which it does not show; "": any bring-up shows it, or none does.
    """

    name: str
    does: str
    group: Group
    source: str
    put_on: PutOn
    shown_by: str = ""


@dataclass(frozen=True)
class QuirkSetting:
    """A quirk of one drive of a machine."""

    drive: str
    name: str

    @property
    def label(self) -> str:
        """The drive and its quirk, as an option says them."""
        return f"{self.drive}:{self.name}"


# ---- where a quirk acts -------------------------------------------------------------------------------
def says(machine: FaultyMachine, drive: Cia402Drive, identifier: int, change: Callable[[bytes], Sequence[bytes]]) -> None:
    """Change the frames that a drive sends with one identifier (plus its node id)."""
    own = identifier + drive.node_id

    def pass_on(can_id: int, data: bytes) -> list[Frame]:
        return [(own, each) for each in change(data)] if can_id == own else [(can_id, data)]

    machine.said.add(drive.node_id, pass_on)


def after_boot_up(machine: FaultyMachine, drive: Cia402Drive, *frames: Frame) -> None:
    """Let a drive send these frames behind each boot-up message."""
    own = ERROR_CONTROL + drive.node_id
    machine.said.add(drive.node_id, lambda can_id, data: [(can_id, data), *(frames if (can_id, data) == (own, BOOT_UP) else ())])


def booted(machine: FaultyMachine, drive: Cia402Drive, act: Callable[[], None]) -> None:
    """Act at each boot-up message."""
    own = ERROR_CONTROL + drive.node_id

    def pass_on(can_id: int, data: bytes) -> list[Frame]:
        if (can_id, data) == (own, BOOT_UP):
            act()
        return [(can_id, data)]

    machine.said.add(drive.node_id, pass_on)


def soon(machine: FaultyMachine, act: Callable[[], object]) -> None:
    """Act once, at the machine's next sample."""

    def once() -> None:
        undo()
        act()

    undo = machine.samples.add("", once)


def reports(machine: FaultyMachine, drive: Cia402Drive, index: int, change: Callable[[int], int]) -> None:
    """Change the value of an object that the drive's PDOs send."""
    entry = drive.objects.find(index)

    def report() -> None:
        entry.value = change(int(entry.value))

    machine.reports.add(drive.node_id, report)


def heeds(machine: FaultyMachine, drive: Cia402Drive, change: Callable[[int], int]) -> None:
    """Change the controlword that the drive takes from its PDOs."""
    known: dict[int, list[Entry]] = {}

    def hear(can_id: int, data: bytes) -> Frame | None:
        if can_id == NMT and data and data[0] == NmtCommand.START:
            known.clear()
            known.update(rpdos(drive))  # they are configured before
        bits = 0
        for entry in known.get(can_id, ()):
            if entry.index == CONTROLWORD:
                at, frame = bits // 8, bytearray(data)
                frame[at : at + 2] = change(int.from_bytes(data[at : at + 2], "little")).to_bytes(2, "little")
                return can_id, bytes(frame)
            bits += entry.bits
        return can_id, data

    machine.heard.add(drive.node_id, hear)


def checks(drive: Cia402Drive, index: int, subindex: int, check: Callable[[int], None]) -> None:
    """Let a drive refuse writes of an object, after its own checks."""
    own = drive.objects.checks.get(key := key_of(index, subindex))

    def both(value: Value) -> None:
        if own is not None:
            own(value)
        check(int(value))

    drive.objects.checks[key] = both


def written(drive: Cia402Drive, index: int, subindex: int, act: Callable[[int], None]) -> None:
    """Act when an object has been written, after its own effects."""
    own = drive.objects.effects.get(key := key_of(index, subindex))

    def both(value: Value) -> None:
        if own is not None:
            own(value)
        act(int(value))

    drive.objects.effects[key] = both
