"""Which error of a recording makes its command, to the last digit, what the file's controller computes.

A law that leaves nothing is exact evidence: no wrong unit, sign, axis or shift leaves its command exact by chance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from controllers.settings import AxisController
from hil.diagnosis.audit.controller import LATEST_ROWS, TOLERANCE, law_leaves, recorded_laws
from hil.diagnosis.audit.readings import Fault
from hil.machine import Machine
from hil.recording import Recording
from hil.recording.recording import UNEQUAL_STEP
from hil.simulation.control_laws import Part, controllers_of, part_of

MOST_ROWS = 2000
"""A law is exact or it is not: more rows say no more."""
LOST = 2.05
"""Rows' periods from which a gap has lost a row: a law does not go on behind it."""
OPPOSITE = "of the opposite sign"
OF_SPEEDS = {
    -1.0: OPPOSITE,
    np.degrees(1.0): "in degrees per second",
    30.0 / np.pi: "in rpm",
    1e3: "in mm/s or mrad/s",
    0.5 / np.pi: "in turns",
}
"""By how many times too large a channel is, and what makes it so."""


def of_positions(machine: Machine, axis: str) -> dict[float, str]:
    """Return by how many times an axis's position may be too large, and what makes it so."""
    ratio = next(drive.ratio for drive in machine.plant.drives if drive.axis == axis)
    unit = machine.units[machine.axis_index(axis)].position
    angles = {np.degrees(1.0): "in degrees", 0.5 / np.pi: "in turns"} if unit == "rad" else {}
    geared = {ratio: f"the motor's, before a gear of {ratio:g}"} if ratio > 1.0 else {}
    return {-1.0: OPPOSITE, **angles, 1e3: f"in m{unit}", **geared}


def of_efforts(machine: Machine, axis: str) -> dict[float, str]:
    """Return the same of an axis's command or measured effort."""
    unit = machine.units[machine.axis_index(axis)].effort
    return {-1.0: OPPOSITE, 1e3: f"in m{unit}", 1e-3: f"in k{unit}"}


def law_faults(machine: Machine, label: str, recording: Recording) -> tuple[list[Fault], set[str]]:
    """Return what the controllers' laws show to be wrong, and the axes whose law is exact as it was recorded."""
    gaps = np.diff(recording.time)
    if len(gaps) < 2 or gaps.max() > LOST * np.median(gaps):
        return [], set()
    own = controllers_of(machine, recording)
    laws = recorded_laws(own)
    parts = {law.axis: part_of(recording, law.axis, rows=MOST_ROWS) for law in laws}
    signals = {axis: part for axis, part in parts.items() if part is not None and np.ptp(part.command) > 0.0}
    found: list[Fault] = []
    lawful = set()
    for controller in laws:
        axis = controller.axis
        if axis not in signals:
            continue
        gain, is_exact = law_leaves(controller, signals[axis])
        if is_exact and abs(gain - 1.0) <= TOLERANCE:
            lawful.add(axis)
        elif exact := next(_exact_ones(machine, controller, signals), None):
            found.append(Fault(label, exact[0], False, f"{label}: {exact[1]}; then the controller's law gives command_{axis} exactly"))
    if lawful and not found:
        found += _wrong_time(machine, label, recording)
    return found, lawful


def _exact_ones(machine: Machine, controller: AxisController, signals: dict[str, Part]) -> Iterator[tuple[str, str]]:
    """Yield channel and sentence of every error that, undone, makes the law exact with its own gain."""
    axis, one = controller.axis, signals[controller.axis]
    for name, said, tried in _errors(machine, axis, one, signals):
        gain, is_exact = law_leaves(controller, tried)
        if is_exact and abs(gain - 1.0) <= TOLERANCE:
            yield name, said


def _errors(machine: Machine, axis: str, one: Part, signals: dict[str, Part]) -> Iterator[tuple[str, str, Part]]:
    for factor, unit in of_efforts(machine, axis).items():
        yield (
            f"command_{axis}",
            f"command_{axis} is {unit}: {factor:.4g} times what it should be",
            replace(one, command=one.command / factor),
        )
    for factor, unit in of_positions(machine, axis).items():
        for kinds in (("position",), ("reference",), ("position", "reference")):
            names = " and ".join(f"{kind}_{axis}" for kind in kinds) + (" is" if len(kinds) == 1 else " are")
            undone = {kind: getattr(one, kind) / factor for kind in kinds}
            yield f"{kinds[0]}_{axis}", f"{names} {unit}: {factor:.4g} times what it should be", replace(one, **undone)
    for other, its in signals.items():
        if other != axis and len(its.command) == len(one.command):
            for kind in ("position", "command"):
                name = f"{kind}_{axis}"
                yield name, f"{name} is not this axis's: {kind}_{other} has its values", replace(one, **{kind: getattr(its, kind)})
    for rows in range(1, LATEST_ROWS + 1):
        for kind in ("position", "reference", "command"):
            for sign, how in ((1, "late"), (-1, "early")):
                shifted = np.roll(getattr(one, kind), -sign * rows)
                kept = slice(rows, -rows)
                parts = {key: value[kept] for key, value in vars(replace(one, **{kind: shifted})).items()}
                yield f"{kind}_{axis}", f"{kind}_{axis} is {rows} row{'s' if rows > 1 else ''} {how}", Part(**parts)


def _wrong_time(machine: Machine, label: str, recording: Recording) -> list[Fault]:
    """Say where rows are the controller's ticks and stamps say otherwise."""
    gaps = np.diff(recording.time)
    period, median = 1.0 / machine.sample_rate_Hz, float(np.median(gaps))
    ticks = f"the controller's law holds from row to row, so that rows are {1e3 * period:.4g} ms apart"
    if abs(np.mean(gaps) / period - 1.0) > UNEQUAL_STEP:
        unit = next(
            (f": time is in {name}" for factor, name in ((1e3, "ms"), (1e6, "us")) if abs(median / period / factor - 1.0) < UNEQUAL_STEP),
            "",
        )
        return [Fault(label, "time", False, f"{label}: {ticks}, and not {1e3 * np.mean(gaps):.4g} ms as time says{unit}")]
    if not recording.is_even:
        said = f"{label}: time stamps jitter by up to {1e3 * np.abs(gaps - period).max():.3g} ms: {ticks}"
        return [Fault(label, "time", False, said)]
    return []
