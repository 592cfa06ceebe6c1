"""Faults of the drives: what the power stage makes of the automaton's effort, and what the drive reports or does by itself."""

from __future__ import annotations

import math
from collections.abc import Callable

from virtual_bus.canopen.drive import Cia402Drive
from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine, Frame
from virtual_bus.faults.motion_log import HOLDING
from virtual_bus.faults.pdo_ids import rpdo_ids
from virtual_bus.faults.seam import Undo, both

STATUSWORD, QUICK_STOP_OPTION, FAULT_REACTION_OPTION = 0x6041, 0x605A, 0x605E
WARNING_BIT, VOLTAGE_BIT = 1 << 7, 1 << 4
OVERCURRENT, OVERVOLTAGE, UNDERVOLTAGE, OVERTEMPERATURE, ENCODER_ERROR, FOLLOWING_ERROR = 0x2310, 0x3210, 0x3220, 0x4310, 0x7305, 0x8611
SHARE = Parameter("share", "", 0.2, -1.0, 5.0, "of the effort that is left")
BAD_BRAKES = (Trial(brake="weak"), Trial(brake="absent"))
"""What a wrong torque is tried with besides: the stop must not leave the axis to a drive that pushes."""
SLIPPING = Trial(brake="slipping")
"""Without the drive's torque the load pulls the closed brake through, slowly at first."""


def drive_of(machine: FaultyMachine, at: str) -> Cia402Drive:
    """Return a drive by its node's name."""
    return machine.drives[at]


def _stage(
    change: Callable[[FaultyMachine, Cia402Drive, Values], Callable[[float], float]],
) -> Callable[[FaultyMachine, str, Values], Undo]:
    """Return what begins a fault of the power stage, from a function that makes its change of the effort. It acts while the stage is on."""

    def begin(machine: FaultyMachine, at: str, values: Values) -> Undo:
        drive = drive_of(machine, at)
        changed = change(machine, drive, values)
        return machine.efforts.add(drive.settings.axis, lambda effort: changed(effort) if drive.power_state in HOLDING else effort)

    return begin


def _lost(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    return lambda effort: 0.0


def _share(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    return lambda effort: values["share"] * effort


def _inverted(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    return lambda effort: -effort


def _at_maximum(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    return lambda effort: math.copysign(drive.settings.limit, values["direction"])


def _offset(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    return lambda effort: effort + values["share"] * drive.settings.rated


def _frozen(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    held: list[float] = []

    def stay(effort: float) -> float:
        held.append(effort)
        del held[1:]
        return held[0]

    return stay


def _late(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    waiting: list[float] = []

    def wait(effort: float) -> float:
        waiting.append(effort)
        return waiting.pop(0) if len(waiting) > values["samples"] else waiting[0]

    return wait


def _ripples(machine: FaultyMachine, drive: Cia402Drive, values: Values) -> Callable[[float], float]:
    numbers = machine.random(f"torque_noisy {drive.settings.axis}")
    return lambda effort: effort + values["share"] * drive.settings.rated * float(numbers.standard_normal())


def deaf(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Ignore every RPDO; the effort of the last one goes on. NMT, SDO and heartbeats work."""
    drive = drive_of(machine, at)
    ids = rpdo_ids(drive)
    return machine.heard.add(drive.node_id, lambda can_id, data: None if can_id in ids else (can_id, data))


def hangs(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Neither hear nor say anything while the power stage applies the last effort: the firmware hangs."""
    drive = drive_of(machine, at)
    silent: list[Frame] = []
    return both(
        machine.efforts.add(drive.settings.axis, _frozen(machine, drive, values)),
        machine.heard.add(drive.node_id, lambda can_id, data: None),
        machine.said.add(drive.node_id, lambda can_id, data: silent),
    )


def loses_power(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Neither hear nor say nor apply anything: its supply is gone. Afterwards it boots."""
    drive = drive_of(machine, at)
    silent: list[Frame] = []
    dead = both(
        machine.efforts.add(drive.settings.axis, _lost(machine, drive, values)),
        machine.heard.add(drive.node_id, lambda can_id, data: None),
        machine.said.add(drive.node_id, lambda can_id, data: silent),
    )

    def boot() -> None:
        dead()
        drive.power_on(machine.time_s)

    return boot


def reports_fault(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Raise a fault with its EMCY; a persistent one cannot be reset while it lasts."""
    drive = drive_of(machine, at)
    code = int(values["code"])
    drive.inject_fault(code, persistent=bool(values["persistent"]))
    return lambda: drive.cause_gone(code)


def reboots(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Boot anew: power stage off, parameters as stored, pre-operational."""
    drive_of(machine, at).power_on(machine.time_s)
    return lambda: None


def statusword_frozen(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Report the statusword of this instant for ever."""
    drive = drive_of(machine, at)
    entry = drive.objects.find(STATUSWORD)
    word = entry.value

    def report() -> None:
        entry.value = word

    return machine.reports.add(drive.node_id, report)


def warns(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Set the warning bit of the statusword."""
    return _bits(machine, at, WARNING_BIT, 0)


def loses_mains(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Clear the bit for voltage and apply no effort: the DC link's supply is off, the electronics' is not."""
    drive = drive_of(machine, at)
    return both(_bits(machine, at, 0, VOLTAGE_BIT), machine.efforts.add(drive.settings.axis, _lost(machine, drive, values)))


def _bits(machine: FaultyMachine, at: str, set_: int, clear: int) -> Undo:
    drive = drive_of(machine, at)
    entry = drive.objects.find(STATUSWORD)

    def report() -> None:
        entry.value = int(entry.value) & ~clear | set_

    return machine.reports.add(drive.node_id, report)


def coasts(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Switch off instead of slowing down in a quick stop and at a fault: the option codes have been lost."""
    drive = drive_of(machine, at)
    for index in (QUICK_STOP_OPTION, FAULT_REACTION_OPTION):
        if (entry := drive.objects.get(index)) is not None:
            entry.value = 0
    return lambda: None


def current_reads_zero(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Report no current whatever flows."""
    return machine.sensors.add(drive_of(machine, at).settings.axis, lambda latched, index: latched.effort.__setitem__(index, 0.0))


CODE = Parameter("code", "", float(OVERCURRENT), 1.0, 0xFFFF, "EMCY error code", whole=True)
PERSISTENT = Parameter("persistent", "", 0.0, 0.0, 1.0, "1: cannot be reset while the fault lasts", whole=True)
_CODES = (OVERCURRENT, OVERVOLTAGE, UNDERVOLTAGE, OVERTEMPERATURE, ENCODER_ERROR, FOLLOWING_ERROR)

KINDS = (
    FaultKind("torque_lost", "The power stage applies no effort; the drive says nothing.", "drive", "drive", _stage(_lost),
              trials=(Trial(), Trial("settled"), Trial("settled", blind=True), Trial("first move"), *BAD_BRAKES, SLIPPING),
              budget="torque_lost"),
    FaultKind("torque_share", "The power stage applies a share of the effort.", "drive", "drive", _stage(_share), (SHARE,),
              (Trial(), *BAD_BRAKES), budget="torque_lost"),
    FaultKind("torque_inverted", "The power stage applies the effort in the other direction.", "drive", "drive", _stage(_inverted),
              trials=(Trial(), Trial("settled"), Trial("first move"), *BAD_BRAKES), budget="runaway"),
    FaultKind("torque_stuck_at_maximum", "The power stage applies its greatest effort whatever is asked.", "drive", "drive",
              _stage(_at_maximum), (Parameter("direction", "", 1.0, -1.0, 1.0, "sign of the effort", whole=True),),
              (Trial(), Trial(values={"direction": -1.0}), Trial("settled"), *BAD_BRAKES,
               *(Trial(values={"direction": -1.0}, brake=brake) for brake in ("weak", "absent"))), budget="runaway"),
    FaultKind("torque_stuck", "The power stage goes on with the effort of one instant.", "drive", "drive", _stage(_frozen),
              trials=(Trial(), *BAD_BRAKES), budget="runaway"),
    FaultKind("torque_offset", "The power stage adds a share of the rated effort.", "drive", "drive", _stage(_offset),
              (Parameter("share", "", 0.3, -5.0, 5.0, "of the rated effort that is added"),), (Trial(), *BAD_BRAKES),
              budget="runaway"),
    FaultKind("torque_late", "The power stage applies the effort some samples late.", "drive", "drive", _stage(_late),
              (Parameter("samples", "", 10.0, 1.0, 1000.0, "by which it is late", whole=True),),
              (Trial(), *BAD_BRAKES), budget="runaway"),
    FaultKind("torque_noisy", "The power stage adds noise.", "drive", "drive", _stage(_ripples),
              (Parameter("share", "", 0.3, 0.0, 5.0, "rms over the rated effort"),), (Trial(), *BAD_BRAKES), budget="runaway"),
    FaultKind("drive_deaf", "The drive ignores RPDOs and goes on with the last effort.", "drive", "drive", deaf,
              trials=(Trial(), Trial("settled")), budget="bench_silent"),
    FaultKind("drive_hangs", "The drive neither hears nor says anything and goes on with the last effort.", "drive", "drive", hangs,
              budget="runaway"),
    FaultKind("drive_loses_power", "The drive is off: no effort, no frames.", "drive", "drive", loses_power,
              trials=(Trial(), Trial(for_s=0.5), SLIPPING, Trial(brake="absent")), budget="drive_fault"),
    FaultKind("drive_loses_mains", "The drive's power supply is off, its electronics' is not: no effort, bit 4 of the statusword.", "drive",
              "drive", loses_mains, budget="drive_fault"),
    FaultKind("drive_reports_fault", "The drive sends an EMCY and goes to fault.", "drive", "drive", reports_fault, (CODE, PERSISTENT),
              (*(Trial(values={"code": float(code)}) for code in _CODES), Trial(values={"persistent": 1.0}), Trial("settled"),
               Trial("settled", brake="slipping"), SLIPPING, Trial(brake="absent")), budget="drive_fault"),
    FaultKind("drive_reboots", "The drive boots anew.", "drive", "drive", reboots, trials=(Trial(), Trial("settled"), Trial("homing")),
              budget="drive_fault"),
    FaultKind("drive_statusword_frozen", "The drive reports the statusword of one instant for ever.", "drive", "drive", statusword_frozen,
              trials=(Trial(), Trial("stop")), budget="bench_silent",
              latent=True),
    FaultKind("drive_warns", "The drive sets the warning bit of its statusword.", "drive", "drive", warns),
    FaultKind("drive_coasts", "The drive switches off instead of slowing down in a quick stop and at a fault.", "drive", "drive", coasts,
              trials=(Trial("stop"),), budget="drive_fault"),
    FaultKind("drive_current_reads_zero", "The drive measures no current whatever flows.", "drive", "drive", current_reads_zero),
)  # fmt: skip
