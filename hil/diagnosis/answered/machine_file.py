"""The machine file with re-tuned numbers, as TOML that loads like any other."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.errors import BadAnswerError
from hil.files.toml_text import toml_text
from hil.machine import Machine
from hil.machine.load import machine_from_text
from virtual_bus.plant.parameters import AXES, INERTIA_ENTRIES, PlantParameter, plant_parameters

ENTRIES = {"center_of_mass": AXES, "inertia": tuple(label for label, _, _ in INERTIA_ENTRIES)}
AGREEMENT = 1e-9


def retuned_text(machine: Machine, parameters: Sequence[PlantParameter], values: np.ndarray) -> str:
    """The machine file's tables with these plant parameters; comments are lost.

    Every number is multiplied by new over nominal value, so that it stays in the unit the file gives it in. Drives without a rotor get one.

    Raises
    ------
    BadAnswerError
        What was written does not read back as these parameters.
    """
    document = tomllib.loads(machine.text)
    for parameter, value in zip(parameters, values, strict=True):
        if value != parameter.value and parameter.value != 0.0:
            _scale(document, machine, parameter, float(value / parameter.value))
        elif value != parameter.value and parameter.quantity.startswith("armature"):
            _add_rotor(document, machine, parameter, float(value))
    text = f"# {machine.name}, its numbers re-tuned to recordings by `isocenter diagnose`\n" + toml_text(document)
    # by their order: a body and a sensor may have the same name
    for read, value in zip(plant_parameters(machine_from_text(text, machine.path).plant), values, strict=True):
        if abs(read.value - value) > AGREEMENT * max(abs(value), 1e-12):
            raise BadAnswerError(f"{machine.name}: re-tuned {read.name} = {value:g} cannot be written into its file")
    return text


def _scale(document: dict[str, Any], machine: Machine, parameter: PlantParameter, factor: float) -> None:
    """Multiply what the file says of one parameter."""
    for body in document.get("body", []):
        joint = body.get("joint", {})
        if body.get("name") == parameter.owner:
            quantity, _, entry = parameter.quantity.rpartition("_")
            if quantity in ENTRIES:
                _scale_entry(body, quantity, ENTRIES[quantity].index(entry), factor)
            else:
                _scale_key(body, parameter.quantity, factor)
        if joint.get("name") == parameter.owner and parameter.quantity != "armature":
            _scale_key(joint, parameter.quantity, factor)
    if parameter.owner in document.get("sensors", {}):
        _scale_key(document["sensors"][parameter.owner], parameter.quantity, factor)
    for axis, drive in document.get("drives", {}).items():
        if axis == parameter.owner and parameter.quantity == "constant":
            _scale_key(drive, "constant", factor)
        if parameter.quantity == "armature" and drive.get("joint") == parameter.owner:
            for rotor in ("rotor_inertia", "rotor_mass"):
                _scale_key(drive, rotor, factor)


def _add_rotor(document: dict[str, Any], machine: Machine, parameter: PlantParameter, value: float) -> None:
    """Give the drive of a joint a rotor, which the file leaves out."""
    for drive in machine.plant.drives:
        if drive.joint == parameter.owner:
            key = "rotor_mass_kg" if parameter.unit == "kg" else "rotor_inertia_kg_m2"
            document["drives"][drive.axis][key] = value / drive.ratio**2


def _scale_key(table: dict[str, Any], quantity: str, factor: float) -> None:
    for key, value in table.items():
        if _is(key, quantity) and isinstance(value, int | float):
            table[key] = value * factor


def _scale_entry(table: dict[str, Any], quantity: str, place: int, factor: float) -> None:
    for key, value in table.items():
        if _is(key, quantity) and isinstance(value, list):
            table[key] = [number * (factor if k == place else 1.0) for k, number in enumerate(value)]


def _is(key: str, quantity: str) -> bool:
    """Whether a key is that quantity with or without a unit: `mass_kg` is, `mass_ratio` of another meaning is not there to be met."""
    return (key == quantity or key.startswith(f"{quantity}_")) and not key.endswith("_unit")
