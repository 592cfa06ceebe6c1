"""Faults of the encoders, of the motor side (at a drive) and of the link (at an encoder's node)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from virtual_bus.faults.fault import Begin, FaultKind, Parameter, Place, Trial, Values
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.seam import Undo
from virtual_bus.sensors.sensing import Latched

Wrong = Callable[[int], int]
"""From the counts that an encoder should show to those it shows."""
Make = Callable[[FaultyMachine, str, Values], Wrong]


def _motor(make: Make) -> Begin:
    def begin(machine: FaultyMachine, at: str, values: Values) -> Undo:
        return _disturb(machine, machine.drives[at].settings.axis, make(machine, at, values), lambda latched: latched.position_counts)

    return begin


def _link(make: Make) -> Begin:
    def begin(machine: FaultyMachine, at: str, values: Values) -> Undo:
        return _disturb(machine, machine.encoders[at].settings.axis, make(machine, at, values), lambda latched: latched.link_counts)

    return begin


def _disturb(machine: FaultyMachine, axis: str, wrong: Wrong, counts_of: Callable[[Latched], np.ndarray]) -> Undo:
    def change(latched: Latched, index: int) -> None:
        counts = counts_of(latched)
        counts[index] = wrong(int(counts[index]))

    return machine.sensors.add(axis, change)


def _frozen(machine: FaultyMachine, at: str, values: Values) -> Wrong:
    held: list[int] = []

    def stay(counts: int) -> int:
        held.append(counts)
        del held[1:]
        return held[0]

    return stay


def _drifts(machine: FaultyMachine, at: str, values: Values) -> Wrong:
    began_s = machine.time_s
    return lambda counts: counts + round(values["rate"] * (machine.time_s - began_s))


def _jumps(machine: FaultyMachine, at: str, values: Values) -> Wrong:
    return lambda counts: counts + int(values["counts"])


def _noisy(machine: FaultyMachine, at: str, values: Values) -> Wrong:
    numbers = machine.random(f"encoder_noisy {at}")
    return lambda counts: counts + round(values["counts"] * float(numbers.standard_normal()))


def _reversed(machine: FaultyMachine, at: str, values: Values) -> Wrong:
    first: list[int] = []

    def mirror(counts: int) -> int:
        first.append(counts)
        del first[1:]
        return 2 * first[0] - counts

    return mirror


def _scaled(machine: FaultyMachine, at: str, values: Values) -> Wrong:
    first: list[int] = []

    def scale(counts: int) -> int:
        first.append(counts)
        del first[1:]
        return first[0] + round(values["factor"] * (counts - first[0]))

    return scale


def _bit_stuck(machine: FaultyMachine, at: str, values: Values) -> Wrong:
    return lambda counts: counts | 1 << int(values["bit"])


_SHAPES: tuple[tuple[str, str, Make, tuple[Parameter, ...], tuple[Trial, ...]], ...] = (
    ("frozen", "shows the position of one instant for ever", _frozen, (), (Trial(), Trial("settled"))),
    ("drifts", "drifts at a constant rate", _drifts, (Parameter("rate", "1/s", 2000.0, -1e9, 1e9, "counts per second"),), (Trial(),)),
    ("jumps", "is off by some counts from one instant on", _jumps,
     (Parameter("counts", "", 100.0, -1e9, 1e9, "by which it is off", whole=True),),
     (Trial(), Trial(values={"counts": 20_000.0}), Trial("settled"))),
    ("noisy", "shows noise", _noisy, (Parameter("counts", "", 200.0, 0.0, 1e9, "rms"),), (Trial(),)),
    ("reversed", "counts the wrong way", _reversed, (), (Trial(), Trial("start"))),
    ("scaled", "counts too many or too few", _scaled, (Parameter("factor", "", 1.1, -10.0, 10.0, "counts over the right ones"),),
     (Trial(), Trial("start"))),
    ("bit_stuck", "has a bit stuck at 1", _bit_stuck, (Parameter("bit", "", 10.0, 0.0, 31.0, "number of the bit", whole=True),),
     (Trial(),)),
)  # fmt: skip


def _kind(side: str, place: Place, begin_of: Callable[[Make], Begin], index: int) -> FaultKind:
    name, does, make, parameters, trials = _SHAPES[index]
    does = f"The {side}'s encoder {does}."
    return FaultKind(f"{side}_encoder_{name}", does, "encoder", place, begin_of(make), parameters, trials, "runaway")


KINDS = (
    *(_kind("motor", "drive", _motor, index) for index in range(len(_SHAPES))),
    *(_kind("link", "encoder", _link, index) for index in range(len(_SHAPES))),
)
