"""The machine file with re-tuned numbers: its own text, comments and order kept, and only numbers changed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import tomlkit
from tomlkit.items import Table

from hil.errors import BadAnswerError, MachineFileError
from hil.machine.editors import with_header
from hil.machine.load import machine_from_text
from hil.machine.machine import Machine
from hil.machine.schema import BodyTable, ImuTable
from hil.machine.table import field_of
from virtual_bus.plant.parameters import AXES, INERTIA_ENTRIES, PlantParameter, plant_parameters

ENTRIES = {"position": AXES, "center_of_mass": AXES, "inertia": tuple(label for label, _, _ in INERTIA_ENTRIES)}
AGREEMENT = 1e-9

ROUNDING = 1e-3
"""Share of a 95 % interval's half width that may be rounded away. Masses and gains that show only in their ratio are known that much better
together than each alone."""
FEWEST_DIGITS, DIGITS, MOST_DIGITS = 4, 6, 12
"""Significant digits of a number with the widest interval, of one without an interval, and of one that is not rounded."""


def retuned_text(
    machine: Machine, parameters: Sequence[PlantParameter], values: np.ndarray, intervals: Mapping[str, tuple[float, float]] | None = None
) -> str:
    """Return the machine's file with these plant parameters.

    Every number is multiplied by new over nominal value, so that it stays in the unit the file gives it in. Drives without a rotor get one.
    With 95 % `intervals`, by `OWNER.QUANTITY`, numbers have the digits that their interval supports.

    Raises
    ------
    BadAnswerError
        What was written does not read back as these parameters.
    """
    if intervals is not None:
        try:
            return _written(machine, parameters, values, intervals)
        except MachineFileError:  # three moments at the end of what a rigid body has are beyond it once they are rounded
            pass
    return _written(machine, parameters, values, None)


def _written(
    machine: Machine, parameters: Sequence[PlantParameter], values: np.ndarray, intervals: Mapping[str, tuple[float, float]] | None
) -> str:
    document = tomlkit.parse(machine.text)
    allowed = []
    for parameter, value in zip(parameters, values, strict=True):
        changed = value != parameter.value
        digits = _digits(parameter, float(value), intervals) if changed else MOST_DIGITS
        allowed.append(AGREEMENT if intervals is None or not changed else 10.0 ** (1 - digits))
        if changed and parameter.value != 0.0:
            _scale(document, parameter, float(value / parameter.value), digits)
        elif changed and parameter.quantity.startswith("armature"):
            _add_rotor(document, machine, parameter, float(value), digits)
        elif changed:
            _fill_in(document, parameter, float(value), digits)
    text = with_header(tomlkit.dumps(document), f"# {machine.name}, its numbers re-tuned to recordings by `isocenter diagnose`")
    # by their order: a body and a sensor may have the same name
    for read, value, share in zip(plant_parameters(machine_from_text(text, machine.path).plant), values, allowed, strict=True):
        if abs(read.value - value) > share * max(abs(value), 1e-12):
            raise BadAnswerError(f"{machine.name}: re-tuned {read.name} = {value:g} cannot be written into its file")
    return text


def _digits(parameter: PlantParameter, value: float, intervals: Mapping[str, tuple[float, float]] | None) -> int:
    """Return the significant digits that a re-tuned number is written with."""
    if intervals is None:
        return MOST_DIGITS
    known = intervals.get(f"{parameter.owner}.{parameter.quantity}")
    half = 0.0 if known is None else 0.5 * abs(known[1] - known[0])
    if not (half > 0.0 and math.isfinite(half) and value):
        return DIGITS
    digits = math.floor(math.log10(abs(value))) + 1 - math.floor(math.log10(ROUNDING * half))
    return min(max(digits, FEWEST_DIGITS), MOST_DIGITS)


def _scale(document: tomlkit.TOMLDocument, parameter: PlantParameter, factor: float, digits: int) -> None:
    """Multiply what the file says of one parameter."""
    for body in document.get("body", []):
        joint = body.get("joint", {})
        if body.get("name") == parameter.owner:
            quantity, _, entry = parameter.quantity.rpartition("_")
            if quantity in ENTRIES:
                _scale_entry(body, quantity, ENTRIES[quantity].index(entry), factor, digits)
            else:
                _scale_key(body, parameter.quantity, factor, digits)
        if joint.get("name") == parameter.owner and parameter.quantity != "armature":
            _scale_key(joint, parameter.quantity, factor, digits)
    if parameter.owner in document.get("sensors", {}):
        _scale_key(document["sensors"][parameter.owner], parameter.quantity, factor, digits)
    for axis, drive in document.get("drives", {}).items():
        if axis == parameter.owner and parameter.quantity == "constant":
            _scale_key(drive, "constant", factor, digits)
        if parameter.quantity == "armature" and drive.get("joint") == parameter.owner:
            for rotor in ("rotor_inertia", "rotor_mass"):
                _scale_key(drive, rotor, factor, digits)


def _fill_in(document: tomlkit.TOMLDocument, parameter: PlantParameter, value: float, digits: int) -> None:
    """Write a number that is zero in the file, or left out."""
    quantity, _, entry = parameter.quantity.rpartition("_")
    bodies = document.get("body", [])
    if quantity in ENTRIES:
        table, of = next(((body, BodyTable) for body in bodies if body.get("name") == parameter.owner), (None, ImuTable))
        if table is None:
            table = document["sensors"][parameter.owner]
        key = next((key for key in table if _is(key, quantity)), None)
        if key is None:
            key = f"{quantity}_{parameter.name.rpartition(f'_{entry}_')[2]}"
            table[key] = [0.0] * len(ENTRIES[quantity])
        _, factor = field_of(of, key)
        table[key][ENTRIES[quantity].index(entry)] = _rounded(value / (factor or 1.0), digits)
        return
    table = next(body["joint"] for body in bodies if body.get("joint", {}).get("name") == parameter.owner)
    for key in [key for key in table if _is(key, parameter.quantity)]:
        del table[key]
    table[parameter.name.partition(".")[2]] = _rounded(value, digits)


def _add_rotor(document: tomlkit.TOMLDocument, machine: Machine, parameter: PlantParameter, value: float, digits: int) -> None:
    """Give the drive of a joint a rotor, which the file leaves out."""
    for drive in machine.plant.drives:
        if drive.joint == parameter.owner:
            key = "rotor_mass_kg" if parameter.unit == "kg" else "rotor_inertia_kg_m2"
            table = document["drives"][drive.axis]
            # behind the constant's unit: at its end stand the comments of the next table
            table.value._insert_after("constant_unit", key, tomlkit.item(_rounded(value / drive.ratio**2, digits)))


def _scale_key(table: Table, quantity: str, factor: float, digits: int) -> None:
    for key, value in list(table.items()):
        if _is(key, quantity) and isinstance(value, int | float):
            table[key] = _rounded(value * factor, digits)


def _scale_entry(table: Table, quantity: str, place: int, factor: float, digits: int) -> None:
    for key, value in list(table.items()):
        if _is(key, quantity) and isinstance(value, list):
            value[place] = _rounded(value[place] * factor, digits)


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}") if digits < MOST_DIGITS else float(value)


def _is(key: str, quantity: str) -> bool:
    """Whether a key is that quantity with or without a unit: `mass_kg` is, `mass_ratio` of another meaning is not there to be met."""
    return (key == quantity or key.startswith(f"{quantity}_")) and not key.endswith("_unit")
