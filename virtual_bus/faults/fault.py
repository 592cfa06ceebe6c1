"""The declaration of a fault: its name, what it does, where it may act, its parameters, and how it is made in the emulated machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from virtual_bus.faults.condition import Condition
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.seam import Undo

Values = Mapping[str, float]
Begin = Callable[[FaultyMachine, str, Values], Undo]
"""Begins a fault at a place with its parameters, and returns what takes it back."""

Place = Literal[
    "axis", "brake", "feedback", "thermometer", "drive", "encoder", "node", "short PDO", "imu", "io", "bus", "producer", "process"
]
PLACES: dict[Place, str] = {
    "axis": "an axis",
    "brake": "an axis with a brake",
    "feedback": "an axis whose brake the I/O watches",
    "thermometer": "an axis with a temperature sensor",
    "drive": "a drive's node",
    "encoder": "a link encoder's node",
    "node": "any node",
    "short PDO": "a node that sends a PDO of fewer than eight bytes",
    "imu": "imu",
    "io": "io",
    "bus": "bus",
    "producer": "the device that sends SYNC, where the bench does not",
    "process": "a process of the bench",
}
"""Kinds of places, and what a faults file writes as `at`."""

Group = Literal["drive", "brake", "I/O", "encoder", "IMU", "temperature", "bus", "process", "homing", "commissioning", "first move"]

Budget = Literal["asked", "position_lost", "drive_fault", "node_silent", "torque_lost", "runaway", "io_silent", "bench_silent"]
"""Class of the machine file's [budgets] that a stop after the fault must keep to."""

Phase = Literal["start", "operational", "first move", "homing", "settled", "sweep", "stop"]
"""Part of a run in which the table of faults tries a fault; "stop": from the start of a sweep that hold-to-run ends."""

Brake = Literal["good", "weak", "slipping", "absent"]
"""The axis's brake in a trial, from standstill on: with a fifth of its torque, with a tenth, or open for ever. Without
the drive nothing holds an axis whose brake is absent."""


@dataclass(frozen=True)
class Parameter:
    """One number of a fault."""

    name: str
    unit: str
    default: float
    low: float
    high: float
    description: str
    whole: bool = False

    @property
    def key(self) -> str:
        """The name as it is written in a faults file: `delay_s`, `share`."""
        suffix = self.unit.replace("/", "_").replace(" ", "_").replace("^", "")
        return f"{self.name}_{suffix}" if suffix else self.name


@dataclass(frozen=True)
class Trial:
    """How the table of faults tries a fault: when in its run, with which parameters, for how long."""

    during: Phase = "sweep"
    values: Mapping[str, float] = field(default_factory=dict)
    for_s: float | None = None  # None: for ever
    brake: Brake = "good"
    blind: bool = False  # both encoders of the axis freeze as well
    killed: bool = False  # all processes of the bench are killed shortly afterwards: nothing reaches bus and I/O any more


@dataclass(frozen=True)
class FaultKind:
    """One fault by name."""

    name: str
    does: str  # in a sentence
    group: Group
    at: Place
    begin: Begin | None  # None: not of the emulated machine but of the bench's processes
    parameters: tuple[Parameter, ...] = ()
    trials: tuple[Trial, ...] = (Trial(),)
    budget: Budget = "asked"
    latent: bool = False  # it shows only when the run needs what it took away


@dataclass(frozen=True)
class FaultSetting:
    """One fault of a faults file, bound to a place of a machine: parameters in SI, in the fault's own order."""

    name: str
    at: str
    parameters: Mapping[str, float]
    when: Condition | None = None
    from_s: float = 0.0
    for_s: float = float("inf")

    @property
    def label(self) -> str:
        """The fault and its place in words."""
        return f"{self.name} at {self.at}"
