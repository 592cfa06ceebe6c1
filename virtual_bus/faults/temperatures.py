"""Faults of the windings' temperature: the winding itself, which drive and I/O see, or the I/O's sensor alone."""

from __future__ import annotations

import math
from collections.abc import Callable

from virtual_bus.faults.fault import FaultKind, Parameter, Trial, Values
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.seam import Undo
from virtual_bus.sensors.sensing import Latched

SHOWN = Parameter("shown", "degC", 150.0, -200.0, 1000.0, "what it shows")
RATE = Parameter("rate", "K/s", 20.0, -1000.0, 1000.0, "how fast it rises")
LONG = (Trial(), Trial("start"))


def _sensor(machine: FaultyMachine, at: str, change: Callable[[float], float]) -> Undo:
    assert machine.faulty_io is not None  # the place was checked: only an I/O has these sensors
    return machine.faulty_io.thermometers.add(at, change)


def shows(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Show one temperature."""
    return _sensor(machine, at, lambda temperature: values["shown"])


def broken(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Show the code for a broken wire."""
    return _sensor(machine, at, lambda temperature: math.nan)


def rises(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Show a temperature that rises."""
    began_s = machine.time_s
    return _sensor(machine, at, lambda temperature: min(temperature + values["rate"] * (machine.time_s - began_s), 1000.0))


def overheats(machine: FaultyMachine, at: str, values: Values) -> Undo:
    """Heat the winding, which the drive's sensor and the I/O's both show."""
    began_s = machine.time_s

    def heat(latched: Latched, index: int) -> None:
        latched.temperature_degC[index] += values["rate"] * (machine.time_s - began_s)

    return machine.sensors.add(at, heat)


KINDS = (
    FaultKind("thermometer_high", "The I/O's temperature sensor shows one high value.", "temperature", "thermometer", shows, (SHOWN,),
              LONG),
    FaultKind("thermometer_broken", "A wire of the I/O's temperature sensor is broken.", "temperature", "thermometer", broken, trials=LONG),
    FaultKind("thermometer_rises", "The I/O's temperature sensor shows a temperature that rises.", "temperature", "thermometer", rises,
              (RATE,)),
    FaultKind("winding_overheats", "The winding gets hotter: drive and I/O both see it.", "temperature", "thermometer", overheats,
              (RATE,), (Trial(), Trial(values={"rate": 200.0}))),
)  # fmt: skip
