"""Quirks of statusword, controlword, modes of operation and homing."""

from __future__ import annotations

from collections import deque

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.drive import VOLTAGE_ENABLED, Cia402Drive
from virtual_bus.canopen.modes.homing import HOMING_ATTAINED, HOMING_START
from virtual_bus.canopen.modes.mode import TARGET_REACHED
from virtual_bus.canopen.objects import key_of
from virtual_bus.canopen.power_state import FAULT_RESET, HALT, PowerState
from virtual_bus.faults.machine import HOMING_MODE, FaultyMachine
from virtual_bus.quirks.quirk import CONTROLWORD, MODE, MODE_DISPLAY, STATUSWORD, Quirk, checks, heeds, reports, soon, written

QUICK_STOP_OPTION, HOMING_METHOD = 0x605A, 0x6098
LATE_S = 0.1
"""How late a statusword is: for this long the report's client waits before it looks at one."""
TO_DISABLED = 2  # of 605Ah: slow down on the quick stop ramp, then go to switch on disabled
SYNCHRONISES_S = 4.0
"""How long the report's drive shows -1: between 3 and 6 s, by chance."""
NO_MODE = -1
KEPT_METHOD = 37  # the present position is home: what the report's drive keeps
NOT_READY = 0x0200  # not ready to switch on, remote
LEFT = ((0x6071, 200), (0x60FF, 200_000), (0x60B1, 200_000), (0x60B2, 200))
"""Targets and offsets that an earlier master has left: torques per mille, velocities in the drive's units."""
_POWERED = (PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE)


def _late(machine: FaultyMachine, drive: Cia402Drive) -> None:
    words: deque[int] = deque(maxlen=round(LATE_S / machine.period_s) + 1)

    def change(word: int) -> int:
        words.append(word)
        return words[0]

    reports(machine, drive, STATUSWORD, change)


def _voltage_late(machine: FaultyMachine, drive: Cia402Drive) -> None:
    reports(machine, drive, STATUSWORD, lambda word: word if drive.power_state in _POWERED else word & ~VOLTAGE_ENABLED)


def _never_ready(machine: FaultyMachine, drive: Cia402Drive) -> None:
    reports(machine, drive, STATUSWORD, lambda word: NOT_READY)
    drive.objects.readings[key_of(STATUSWORD)] = lambda: NOT_READY
    heeds(machine, drive, lambda word: 0)


def _quick_stop_to_disabled(machine: FaultyMachine, drive: Cia402Drive) -> None:
    entry = drive.objects.find(QUICK_STOP_OPTION)
    told = int(entry.value)

    def keep(value: int) -> None:
        nonlocal told
        told, entry.value = value, TO_DISABLED

    entry.default = entry.value = TO_DISABLED
    drive.objects.readings[entry.key] = lambda: told
    written(drive, QUICK_STOP_OPTION, 0, keep)


def _second_reset(machine: FaultyMachine, drive: Cia402Drive) -> None:
    edges, before = 0, 0

    def change(word: int) -> int:
        nonlocal edges, before
        edges += bool(word & ~before & FAULT_RESET)
        before = word
        return word & ~FAULT_RESET if edges % 2 else word

    heeds(machine, drive, change)


def _left(machine: FaultyMachine, drive: Cia402Drive) -> None:
    def leave() -> None:
        for index, value in LEFT:
            if (entry := drive.objects.get(index)) is not None:
                entry.value = value

    soon(machine, leave)


def _display_late(machine: FaultyMachine, drive: Cia402Drive) -> None:
    until_s, mode = 0.0, 0

    def choose(value: int) -> None:
        nonlocal until_s, mode
        if value != mode:
            mode, until_s = value, machine.time_s + SYNCHRONISES_S

    written(drive, MODE, 0, choose)
    shown = drive.objects.find(MODE_DISPLAY)
    drive.objects.readings[shown.key] = lambda: NO_MODE if machine.time_s < until_s else shown.value


def _refuses_mode(machine: FaultyMachine, drive: Cia402Drive) -> None:
    def check(mode: int) -> None:
        if drive.power_state in _POWERED and mode != drive.objects.number(MODE_DISPLAY):
            raise SdoAbortError(abort.DEVICE_STATE)

    checks(drive, MODE, 0, check)


def _refuses_mode_halted(machine: FaultyMachine, drive: Cia402Drive) -> None:
    def check(mode: int) -> None:
        if drive.objects.number(CONTROLWORD) & HALT:
            raise SdoAbortError(abort.DEVICE_STATE)

    checks(drive, MODE, 0, check)


def _needs_mode(machine: FaultyMachine, drive: Cia402Drive) -> None:
    heeds(machine, drive, lambda word: word if drive.objects.number(MODE_DISPLAY) else word & ~0x08)


def _never_reached(machine: FaultyMachine, drive: Cia402Drive) -> None:
    def change(word: int) -> int:
        return word & ~TARGET_REACHED if drive.objects.number(MODE_DISPLAY) == HOMING_MODE else word

    reports(machine, drive, STATUSWORD, change)


def _keeps_method(machine: FaultyMachine, drive: Cia402Drive) -> None:
    entry = drive.objects.find(HOMING_METHOD)

    def keep(value: int) -> None:
        entry.value = KEPT_METHOD

    written(drive, HOMING_METHOD, 0, keep)


def _still_homed(machine: FaultyMachine, drive: Cia402Drive) -> None:
    started_s = float("inf")

    def change(word: int) -> int:
        nonlocal started_s
        homes = drive.objects.number(MODE_DISPLAY) == HOMING_MODE
        if homes and drive.objects.number(CONTROLWORD) & HOMING_START:
            started_s = min(started_s, machine.time_s)
        elif not homes:
            started_s = float("inf")
        old = homes and machine.time_s < started_s + LATE_S
        return word | HOMING_ATTAINED | TARGET_REACHED if old else word

    reports(machine, drive, STATUSWORD, change)


QUIRKS = (
    Quirk("statusword_late", "Its statusword is 0.1 s late.", "states",
          "https://github.com/canopen-python/canopen/pull/252", _late),
    Quirk("voltage_bit_late", "Bit 4 of its statusword, voltage enabled, is set only while it is enabled.", "states",
          "https://github.com/machinekit/machinekit/issues/589", _voltage_late),
    Quirk("never_ready", "It stays not ready to switch on.", "states",
          "https://github.com/OpenEtherCATsociety/SOEM/issues/201", _never_ready),
    Quirk("quick_stop_to_disabled", "It loses its voltage at the end of a quick stop whatever option (605Ah) it has taken.", "states",
          "https://github.com/canopen-python/canopen/issues/167", _quick_stop_to_disabled),
    Quirk("second_reset", "It takes only every second fault reset.", "states",
          "https://github.com/nasa-jpl/fastcat/issues/5", _second_reset, shown_by="drive_starts_in_fault"),
    Quirk("targets_left", "It still has an earlier master's target torque, target velocity and offsets.", "states",
          "https://github.com/ros-industrial/ros_canopen/issues/111", _left),
    Quirk("mode_display_late", "It shows mode -1 for 4 s after a change of mode.", "modes",
          "https://github.com/ros-industrial/ros_canopen/issues/457", _display_late),
    Quirk("mode_refused_enabled", "It refuses another mode while it is enabled or in a quick stop.", "modes",
          "https://github.com/ipa320/ipa_canopen/pull/29", _refuses_mode),
    Quirk("mode_refused_halted", "It refuses another mode while the halt bit is set.", "modes",
          "https://github.com/ros-industrial/ros2_canopen/issues/234", _refuses_mode_halted),
    Quirk("mode_needed", "It is not enabled before a mode is chosen.", "modes",
          "https://github.com/ros-industrial/ros_canopen/pull/331", _needs_mode),
    Quirk("homing_never_reached", "It never sets bit 10 of its statusword, target reached, in homing.", "homing",
          "https://github.com/ros-industrial/ros2_canopen/issues/245", _never_reached),
    Quirk("homing_method_kept", "It acknowledges any homing method and keeps 37.", "homing",
          "https://github.com/ros-industrial/ros2_canopen/issues/328", _keeps_method),
    Quirk("still_homed", "It says homing attained, from an earlier time, until 0.1 s after a new homing has begun.", "homing",
          "https://github.com/canopen-python/canopen/pull/248", _still_homed),
)  # fmt: skip
