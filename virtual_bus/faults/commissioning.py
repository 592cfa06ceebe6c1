"""Faults that show while a machine is configured, moved for the first time and homed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from virtual_bus.canopen import abort
from virtual_bus.canopen.abort import SdoAbortError
from virtual_bus.canopen.homing import NEGATIVE, POSITIVE, Homing, HomingState, Reference
from virtual_bus.canopen.objects import Value, key_of
from virtual_bus.canopen.power_state import PowerState
from virtual_bus.faults.drives import drive_of
from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine, Frame
from virtual_bus.faults.nodes import node_of, unplugged
from virtual_bus.faults.seam import Undo, both

SDO_ANSWER, HEARTBEAT, BOOT_UP = 0x580, 0x700, b"\x00"
IDENTITY, MODE_DISPLAY, HEARTBEAT_TIME = 0x1018, 0x6061, 0x1017
SOFTWARE_ERROR = 0x6100
FROM_START = (Trial("start"),)
NOTHING: list[Frame] = []


class EndlessHoming(Homing):
    """A homing run that never finds its reference."""

    def start(self, method: int, counts: int) -> None:
        """Begin, and go on."""
        super().start(method, counts)
        self.state = HomingState.SEARCHING

    def update(self, counts: int, search_speed: float, zero_speed: float, standing: bool) -> float:
        """Stand where it is."""
        return 0.0


class FailingHoming(Homing):
    """A homing run that ends with an error."""

    def start(self, method: int, counts: int) -> None:
        """Begin, and fail."""
        super().start(method, counts)
        self.state = HomingState.FAILED


class ReversedHoming(Homing):
    """A homing run that searches in the wrong direction."""

    def update(self, counts: int, search_speed: float, zero_speed: float, standing: bool) -> float:
        """Return the speed with the other sign."""
        return -super().update(counts, search_speed, zero_speed, standing)


class ShiftedHoming(Homing):
    """A homing run that takes another count for its reference."""

    shift = 0

    def start(self, method: int, counts: int) -> None:
        """Begin with a counter that is off."""
        super().start(method, counts)
        self.home_counts += self.shift

    def _found(self, home: int) -> float:
        """Take a reference that was searched for one that is off."""
        return super()._found(home + self.shift)


@dataclass(frozen=True)
class SwitchStuck(Reference):
    """A reference whose limit switches are always active."""

    def switches(self, counts: int) -> int:
        """Return that both are."""
        return NEGATIVE | POSITIVE


@dataclass(frozen=True)
class IndexMissing(Reference):
    """A reference whose index pulse never comes."""

    def index_between(self, before: int, after: int) -> int | None:
        """Return that none came."""
        return None


def _homing(kind: Callable[[Reference], Homing]) -> Callable[[FaultyMachine, str, Values], Undo]:
    def begin(machine: FaultyMachine, at: str, values: Values) -> Undo:
        drive = drive_of(machine, at)
        before = drive.homing
        drive.homing = kind(before.reference)
        if isinstance(drive.homing, ShiftedHoming):
            drive.homing.shift = int(values["counts"])

        def undo() -> None:
            drive.homing = before

        return undo

    return begin


def _reference(kind: type[Reference]) -> Callable[[FaultyMachine, str, Values], Undo]:
    def begin(machine: FaultyMachine, at: str, values: Values) -> Undo:
        homing = drive_of(machine, at).homing
        before = homing.reference
        homing.reference = kind(*(getattr(before, field.name) for field in fields(before)))

        def undo() -> None:
            homing.reference = before

        return undo

    return begin


def mode_never_follows(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Display no mode of operation whatever is asked."""
    readings, key = drive_of(machine, at).objects.readings, key_of(MODE_DISPLAY)
    readings[key] = lambda: 0

    def undo() -> None:
        readings.pop(key, None)

    return undo


def reset_refused(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Be in fault, with a cause that stays."""
    drive = drive_of(machine, at)

    def stay_in_fault() -> None:
        if drive.power_state not in (PowerState.FAULT, PowerState.FAULT_REACTION_ACTIVE):
            drive.inject_fault(SOFTWARE_ERROR, persistent=True)

    stay_in_fault()
    return both(machine.samples.add("", stay_in_fault), lambda: drive.cause_gone(SOFTWARE_ERROR))


def starts_in_fault(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Be in fault, with a cause that is gone."""
    drive_of(machine, at).inject_fault(SOFTWARE_ERROR)
    return lambda: None


def sdo_aborts(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Abort writes of one object."""
    checks, key = node_of(machine, at).objects.checks, key_of(int(values["index"]), int(values["subindex"]))
    before = checks.get(key)

    def refuse(value: Value) -> None:
        raise SdoAbortError(abort.HARDWARE)

    checks[key] = refuse

    def undo() -> None:
        if before is None:
            checks.pop(key, None)
        else:
            checks[key] = before

    return undo


def sdo_silent(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Answer no SDO."""
    node = node_of(machine, at)
    own = SDO_ANSWER + node.node_id
    return machine.said.add(node.node_id, lambda can_id, data: NOTHING if can_id == own else [(can_id, data)])


def sdo_wrong_object(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Answer SDOs with another object's index."""
    node = node_of(machine, at)
    own = SDO_ANSWER + node.node_id

    def twist(can_id: int, data: bytes) -> list[Frame]:
        return [(can_id, data[:1] + bytes((data[1] ^ 0xFF,)) + data[2:] if can_id == own else data)]

    return machine.said.add(node.node_id, twist)


def writes_forgotten(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Acknowledge writes of one object and keep its value."""
    objects = node_of(machine, at).objects
    key = key_of(int(values["index"]), int(values["subindex"]))
    entry = objects.find(int(values["index"]), int(values["subindex"]))
    kept, before = entry.value, objects.effects.get(key)

    def forget(value: Value) -> None:
        entry.value = kept

    objects.effects[key] = forget

    def undo() -> None:
        if before is None:
            objects.effects.pop(key, None)
        else:
            objects.effects[key] = before

    return undo


def identity_differs(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Be another product."""
    node, subindex = node_of(machine, at), int(values["subindex"])
    before = node.objects.find(IDENTITY, subindex).default
    node.factory_setting(IDENTITY, subindex, int(before) ^ 0x0001_0001)
    return lambda: node.factory_setting(IDENTITY, subindex, before)


def id_twice(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Let a second device with the same node id boot and answer SDOs too."""
    node = node_of(machine, at)
    doubled = (SDO_ANSWER + node.node_id, HEARTBEAT + node.node_id)

    def twice(can_id: int, data: bytes) -> list[Frame]:
        return [(can_id, data)] * (2 if can_id in doubled else 1)

    return machine.said.add(node.node_id, twice)


INDEX = Parameter("index", "", float(HEARTBEAT_TIME), 0x1000, 0xFFFF, "of the object", whole=True)
SUBINDEX = Parameter("subindex", "", 0.0, 0.0, 255.0, "of the object", whole=True)
KINDS = (
    FaultKind("homing_never_ends", "The drive's homing never ends.", "homing", "drive", _homing(EndlessHoming), trials=FROM_START),
    FaultKind("homing_error", "The drive's homing ends with an error.", "homing", "drive", _homing(FailingHoming), trials=FROM_START),
    FaultKind("homing_wrong_direction", "The drive searches its reference in the wrong direction.", "homing", "drive",
              _homing(ReversedHoming), trials=FROM_START),
    FaultKind("homing_shifted", "The drive's homing takes another count for its reference.", "homing", "drive", _homing(ShiftedHoming),
              (Parameter("counts", "", 5000.0, -1e9, 1e9, "by which it is off", whole=True),), FROM_START),
    FaultKind("limit_switch_stuck", "The drive's limit switches are always active.", "homing", "drive", _reference(SwitchStuck),
              trials=FROM_START),
    FaultKind("index_pulse_missing", "The encoder's index pulse never comes.", "homing", "drive", _reference(IndexMissing),
              trials=FROM_START),
    FaultKind("mode_never_follows", "The drive's mode display never follows the mode that was asked.", "homing", "drive",
              mode_never_follows, trials=FROM_START),
    FaultKind("fault_reset_refused", "The drive is in fault and cannot be reset.", "commissioning", "drive", reset_refused,
              trials=(Trial("operational"), Trial("first move"))),
    FaultKind("drive_starts_in_fault", "The drive is in fault, which a reset ends.", "commissioning", "drive", starts_in_fault,
              trials=(Trial("operational"),)),
    FaultKind("sdo_aborts", "The node refuses writes of one object.", "commissioning", "node", sdo_aborts, (INDEX, SUBINDEX), FROM_START),
    FaultKind("sdo_silent", "The node answers no SDO.", "commissioning", "node", sdo_silent, trials=FROM_START),
    FaultKind("sdo_wrong_object", "The node answers SDOs with another object's index.", "commissioning", "node", sdo_wrong_object,
              trials=FROM_START),
    FaultKind("writes_forgotten", "The node acknowledges writes of one object and keeps its old value.", "commissioning", "node",
              writes_forgotten, (INDEX, SUBINDEX), FROM_START),
    FaultKind("identity_differs", "The node is another product.", "commissioning", "node", identity_differs,
              (Parameter("subindex", "", 2.0, 1.0, 3.0, "of 1018h: 1 vendor, 2 product, 3 revision", whole=True),), FROM_START),
    FaultKind("node_absent", "The node is not there.", "commissioning", "node", unplugged, trials=FROM_START),
    FaultKind("node_id_twice", "Two nodes have the same id.", "commissioning", "node", id_twice, trials=FROM_START),
)  # fmt: skip
