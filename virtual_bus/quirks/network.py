"""Quirks of boot-up, heartbeat, NMT, identity, PDOs and emergency messages."""

from __future__ import annotations

from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.canopen.nmt import NmtCommand, NmtState
from virtual_bus.canopen.objects import key_of
from virtual_bus.faults.machine import FaultyMachine, Frame
from virtual_bus.faults.pdo_ids import rpdos
from virtual_bus.quirks.quirk import BOOT_UP, EMERGENCY, ERROR_CONTROL, NMT, PutOn, Quirk, after_boot_up, booted, says, soon
from virtual_bus.quirks.sdo import lacks

ERROR_REGISTER, IDENTITY, REVISION, SERIAL = 0x1001, 0x1018, 3, 4
HEARTBEAT_TIME, HEARTBEAT_CONSUMER = 0x1017, 0x1016
BURST = 4  # heartbeats instead of one, as in the report
TOGGLE = 0x80
SERIAL_NUMBER = 4711
HEARD_OF = 10  # RPDOs, of which one is obeyed: the report's SYNC has ten times the device's period
SOFTWARE_ERROR = 0x6100
NO_ERROR_EMCY = bytes(8)


def _again(*states: int) -> PutOn:
    """Return what lets a drive send these states behind its boot-up message; it has a serial number, as real drives have."""

    def put_on(machine: FaultyMachine, drive: Cia402Drive) -> None:
        drive.factory_setting(IDENTITY, SERIAL, SERIAL_NUMBER)
        after_boot_up(machine, drive, *((ERROR_CONTROL + drive.node_id, bytes((state,))) for state in states))

    return put_on


def _burst(machine: FaultyMachine, drive: Cia402Drive) -> None:
    fresh = True

    def change(data: bytes) -> list[bytes]:
        nonlocal fresh
        times = BURST if fresh and data != BOOT_UP else 1
        fresh = data == BOOT_UP
        return [data] * times

    says(machine, drive, ERROR_CONTROL, change)


def _toggles(machine: FaultyMachine, drive: Cia402Drive) -> None:
    bit = 0

    def change(data: bytes) -> list[bytes]:
        nonlocal bit
        if data == BOOT_UP:
            return [data]
        bit ^= TOGGLE
        return [bytes((data[0] | bit,))]

    says(machine, drive, ERROR_CONTROL, change)


def _starts_by_itself(machine: FaultyMachine, drive: Cia402Drive) -> None:
    start = bytes((NmtCommand.START, drive.node_id))
    booted(machine, drive, lambda: soon(machine, lambda: drive.receive(NMT, start, machine.time_s)))


def _no_start_in_error(machine: FaultyMachine, drive: Cia402Drive) -> None:
    def hear(can_id: int, data: bytes) -> Frame | None:
        starts = can_id == NMT and data[:1] == bytes((NmtCommand.START,))
        return None if starts and drive.objects.number(ERROR_REGISTER) else (can_id, data)

    machine.heard.add(drive.node_id, hear)
    soon(machine, lambda: drive.inject_fault(SOFTWARE_ERROR))


def _newer(machine: FaultyMachine, drive: Cia402Drive) -> None:
    drive.factory_setting(IDENTITY, REVISION, drive.objects.default(IDENTITY, REVISION) + 1)


def _rpdo_at_once(machine: FaultyMachine, drive: Cia402Drive) -> None:
    def hear(can_id: int, data: bytes) -> Frame | None:
        if can_id >> 8 in (2, 3, 4, 5) and drive.state is NmtState.OPERATIONAL:  # receive PDOs of the predefined connection set
            for own, entries in rpdos(drive):
                at = 0
                for entry in entries if own == can_id else ():
                    entry.value = entry.decode(data[at : at + entry.bits // 8])
                    at += entry.bits // 8
                    if (effect := drive.objects.effects.get(entry.key)) is not None:
                        effect(entry.value)
        return can_id, data

    machine.heard.add(drive.node_id, hear)


def _rpdos_lost(machine: FaultyMachine, drive: Cia402Drive) -> None:
    count = 0

    def hear(can_id: int, data: bytes) -> Frame | None:
        nonlocal count
        if can_id not in (0x200 + drive.node_id, 0x300 + drive.node_id):
            return can_id, data
        count += 1
        return (can_id, data) if count % HEARD_OF == 1 else None

    machine.heard.add(drive.node_id, hear)


def _no_register(machine: FaultyMachine, drive: Cia402Drive) -> None:
    says(machine, drive, EMERGENCY, lambda data: [data[:2] + b"\0" + data[3:]])
    drive.objects.readings[key_of(ERROR_REGISTER)] = lambda: 0


def _emcy_at_boot(machine: FaultyMachine, drive: Cia402Drive) -> None:
    after_boot_up(machine, drive, (EMERGENCY + drive.node_id, NO_ERROR_EMCY))


QUIRKS = (
    Quirk("boot_up_twice", "Its boot-up message comes twice.", "network",
          "https://github.com/ros-industrial/ros2_canopen/issues/271", _again(NmtState.INITIALISING)),
    Quirk("boot_up_then_state", "It sends its state once behind the boot-up message, though its heartbeat is off.", "network",
          "https://github.com/CANopenNode/CANopenNode/issues/366", _again(NmtState.PRE_OPERATIONAL)),
    Quirk("heartbeat_burst", "Its first heartbeat after a reset comes four times at once.", "network",
          "https://github.com/CANopenNode/CANopenNode/issues/30", _burst),
    Quirk("heartbeat_toggles", "The highest bit of its heartbeat toggles, as in node guarding.", "network",
          "https://github.com/canopen-python/canopen/issues/131", _toggles),
    Quirk("no_heartbeat", "It knows node guarding only: it lacks the heartbeat's period (1017h), which its data sheet has.", "network",
          "https://github.com/ros-industrial/ros_canopen/issues/106", lacks(HEARTBEAT_TIME)),
    Quirk("no_heartbeat_consumer", "It watches no heartbeat of a master: it lacks 1016h, which its data sheet has.", "network",
          "https://github.com/ros-industrial/ros_canopen/issues/367", lacks(HEARTBEAT_CONSUMER, 1)),
    Quirk("starts_by_itself", "It is operational after its boot-up without being told to.", "network",
          "https://github.com/CANopenNode/CANopenNode/pull/107", _starts_by_itself),
    Quirk("no_start_in_error", "It has an error from before, and takes no NMT start while its error register is not zero.", "network",
          "https://github.com/CANopenNode/CANopenNode/issues/26", _no_start_in_error),
    Quirk("newer_revision", "Its revision number (1018h:03) is newer than its data sheet's.", "network",
          "https://github.com/ros-industrial/ros2_canopen/issues/301", _newer),
    Quirk("rpdo_at_once", "It obeys synchronous RPDOs when they come and not at the SYNC.", "network",
          "https://github.com/canopen-python/canopen/issues/400", _rpdo_at_once),
    Quirk("rpdos_lost", "It obeys one synchronous RPDO out of ten.", "network",
          "https://github.com/CANopenNode/CANopenNode/issues/23", _rpdos_lost),
    Quirk("emcy_no_register", "Its error register is zero in EMCYs and in 1001h whatever the error.", "EMCY",
          "https://github.com/CANopenNode/CANopenNode/issues/190", _no_register, shown_by="drive_reports_fault"),
    Quirk("emcy_at_boot", "It sends an EMCY of zeros, no error, behind its boot-up message.", "EMCY",
          "https://github.com/ros-industrial/ros_canopen/pull/291", _emcy_at_boot),
)  # fmt: skip
