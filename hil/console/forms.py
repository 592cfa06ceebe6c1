"""Forms of experiments: their fields, and the experiment file that a filled form is. What is previewed is the file that is run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from hil.console.facts import AxisFacts, Facts
from hil.errors import UnusableInputError
from hil.files.toml_text import toml_text

ALL_AXES = "all"


@dataclass(frozen=True)
class Field:
    """One field of a form: a number with its unit and bounds, or a choice."""

    name: str
    label: str
    value: float | str
    unit: str = ""
    low: float = -1e9
    high: float = 1e9
    whole: bool = False
    choices: tuple[str, ...] = ()

    def read(self, values: Mapping[str, Any]) -> float | str:
        """Return the value of a filled form, or this field's own where it is left out.

        Raises
        ------
        UnusableInputError
            It is no number, out of bounds, or none of the choices.
        """
        given = values.get(self.name, self.value)
        if self.choices:
            if given not in self.choices:
                raise UnusableInputError(f"{self.label}: must be {', '.join(self.choices)}")
            return str(given)
        try:
            number = float(given)
        except (TypeError, ValueError):
            number = math.nan
        if not self.low <= number <= self.high or (self.whole and number != round(number)):
            what = "a whole number" if self.whole else "a number"
            raise UnusableInputError(f"{self.label}: must be {what} from {self.low:g} to {self.high:g} {self.unit}".rstrip())
        return round(number) if self.whole else number


@dataclass(frozen=True)
class Form:
    """An experiment as a form."""

    kind: str
    title: str
    says: str
    fields: tuple[Field, ...]
    table: Callable[[Facts, Mapping[str, Any]], dict[str, Any]]

    def text(self, facts: Facts, values: Mapping[str, Any]) -> str:
        """Return the experiment file of a filled form.

        Raises
        ------
        UnusableInputError
            A field cannot be used.
        """
        read = {field.name: field.read(values) for field in self.fields}
        table = {"format": 1, "kind": self.kind} | self.table(facts, read)
        pose = {f"{axis.name}_{axis.edge_unit}": read[f"pose_{axis.name}"] for axis in facts.axes if f"pose_{axis.name}" in read}
        if pose:
            table["pose"] = pose
        return toml_text(table)


def forms_of(facts: Facts) -> dict[str, Form]:
    """Return the forms for a machine, by kind of experiment."""
    names = tuple(axis.name for axis in facts.axes)
    first = facts.axes[0]
    which = Field("axes", "Axes", ALL_AXES, choices=(ALL_AXES, *names))
    pose = tuple(
        Field(f"pose_{axis.name}", f"Start pose, {axis.name}", 0.0, axis.edge_unit, round(axis.lower, 6), round(axis.upper, 6))
        for axis in facts.axes
    )
    jog = Field("jog", "Jog amplitude", 2.0, first.edge_unit, 0.0, 0.5 * (first.upper - first.lower))
    periods = Field("periods", "Periods kept", 2, low=1, high=1000, whole=True)
    sweep = _widest(facts)
    forms = (
        Form(
            "static",
            "Static",
            "Holds a pose. Shows noise, drift and the effort that holds.",
            (Field("seconds", "Duration", 10.0, "s", 0.1, 36_000.0), *pose),
            lambda facts, read: {"duration_s": read["seconds"]},
        ),
        Form(
            "jog",
            "Jog",
            "Moves axes slowly to and fro on a sine. Shows friction and backlash.",
            (which, jog, Field("period", "Period", 20.0, "s", 0.1, 1000.0), periods, *pose),
            lambda facts, read: (
                _axes(facts, read)
                | {"period_s": read["period"], "periods": read["periods"], "jog": {f"amplitude_{first.edge_unit}": read["jog"], "line": 1}}
            ),
        ),
        Form(
            "scan",
            "Scan",
            "Sweeps one axis at constant speed, as an acquisition does.",
            (
                Field("axis", "Axis", sweep.name, choices=names),
                Field("from", "From", -20.0, first.edge_unit),
                Field("to", "To", 20.0, first.edge_unit),
                Field("speed", "Speed", 30.0, f"{first.edge_unit}/s", 1e-3, 1e4),
                Field("sweeps", "Sweeps (2: there and back)", 1, low=1, high=100, whole=True),
            ),
            _scan,
        ),
        Form(
            "multisine",
            "Multisine",
            "Adds sines with random phases to the commands, under a slow jog. Frequency responses are identified from it.",
            (
                which,
                Field("amplitude", "Rms of the excitation", 0.8, first.effort_unit, 1e-6, 1e6),
                Field("low", "Band from", 0.15, "Hz", 1e-3, 0.5 * facts.rate_Hz),
                Field("high", "Band to", 40.0, "Hz", 1e-3, 0.5 * facts.rate_Hz),
                Field("period", "Base period", 20.0, "s", 0.1, 1000.0),
                periods,
                Field("realisations", "Draws of the phases", 2, low=1, high=100, whole=True),
                jog,
                *pose,
            ),
            _multisine,
        ),
    )
    return {form.kind: form for form in forms}


def _widest(facts: Facts) -> AxisFacts:
    return max(facts.axes, key=lambda axis: axis.upper - axis.lower)


def _axes(facts: Facts, read: Mapping[str, Any]) -> dict[str, Any]:
    return {} if read["axes"] == ALL_AXES else {"axes": [read["axes"]]}


def _scan(facts: Facts, read: Mapping[str, Any]) -> dict[str, Any]:
    unit = facts.axis(read["axis"]).edge_unit
    return {
        "axis": read["axis"],
        f"start_{unit}": read["from"],
        f"stop_{unit}": read["to"],
        f"speed_{unit}_s": read["speed"],
        "sweeps": read["sweeps"],
    }


def _multisine(facts: Facts, read: Mapping[str, Any]) -> dict[str, Any]:
    first = facts.axes[0]
    table = _axes(facts, read) | {
        "period_s": read["period"],
        "periods": read["periods"],
        "realisations": read["realisations"],
        f"amplitude_{first.effort_unit}": read["amplitude"],
        "band": {"low_Hz": read["low"], "high_Hz": read["high"]},
    }
    if read["jog"]:
        table["jog"] = {f"amplitude_{first.edge_unit}": read["jog"], "line": 1}
    return table
