"""Tables of an experiment file, made for a machine, whose axes are keys. A field is None where the file has no value."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from hil.machine import Machine
from hil.machine.messages import ComplaintError
from hil.machine.table import Flag, Name, NotNegative, Number, Positive, Table, Whole
from hil.machine.units import UNITS, Quantity

FORMAT = 1
"""Key `format` of an experiment file: which set of keys it uses."""

Count = Annotated[Whole, Field(ge=0)]
AtLeastOne = Annotated[Whole, Field(ge=1)]
Position = Annotated[Number | None, Quantity("angle", "length")]
Duration = Annotated[NotNegative | None, Quantity("time")]
Frequency = Annotated[Positive | None, Quantity("frequency")]


class AxisTable(Table):
    """Values by axis; made by `axis_table` with the machine's axes as fields."""

    def by_axis(self) -> dict[str, float]:
        """Return the values of the axes in the file."""
        return {name: getattr(self, name) for name in type(self).model_fields if self.has(name)}


class BandTable(Table):
    """[band]: a choice of lines by frequency."""

    low: Frequency = None
    high: Frequency = None
    per_decade: Count | None = None
    dense: Annotated[tuple[tuple[Number, Number], ...] | None, Quantity("frequency")] = None
    odd: Flag | None = None
    one_free_in: Count | None = None


class JogTable(Table):
    """[jog]: a slow sine on the reference."""

    amplitude: Annotated[Positive | None, Quantity("angle", "length")] = None
    line: AtLeastOne | None = None
    frequency: Frequency = None
    turn_share: Annotated[Positive, Field(le=1.0)] | None = None
    axes: tuple[Name, ...] | None = None


class ExperimentTable(Table):
    """What every experiment file has."""

    format: Literal[1]
    kind: str


class PeriodicTable(ExperimentTable):
    """What multisine and jog share."""

    axes: tuple[Name, ...] | None = None
    period: Annotated[Positive | None, Quantity("time")] = None
    periods: AtLeastOne | None = None
    settle_periods: Count | None = None
    jog: JogTable | None = None


class MultisineTable(PeriodicTable):
    """kind = "multisine"."""

    experiments: Literal["orthogonal", "single"] | None = None
    lines: tuple[Whole, ...] | None = None
    band: BandTable | None = None
    weights: tuple[Positive, ...] | None = None
    amplitude: Annotated[Positive | None, Quantity("current", "voltage", "torque", "force")] = None
    realisations: AtLeastOne | None = None
    phases: Literal["random", "optimised"] | None = None
    seed: Count | None = None


class ScanTable(ExperimentTable):
    """kind = "scan"."""

    axis: Name
    start: Annotated[Number, Quantity("angle", "length")]
    stop: Annotated[Number, Quantity("angle", "length")]
    speed: Annotated[Positive | None, Quantity("angular_speed", "speed")] = None
    acceleration: Annotated[Positive | None, Quantity("angular_acceleration", "acceleration")] = None
    dwell: Duration = None
    sweeps: AtLeastOne | None = None


class StaticTable(ExperimentTable):
    """kind = "static"."""

    duration: Annotated[Positive | None, Quantity("time")] = None


class TourTable(ExperimentTable):
    """kind = "tour"."""

    pace: Annotated[Positive, Field(le=1.0)] | None = None
    dwell: Duration = None


# kind -> its table, and its further tables by axis: field -> "position", "effort", or "positions", a list that is required
_KINDS: dict[str, tuple[type[ExperimentTable], dict[str, str]]] = {
    "multisine": (MultisineTable, {"pose": "position", "amplitudes": "effort"}),
    "jog": (PeriodicTable, {"pose": "position"}),
    "scan": (ScanTable, {"pose": "position"}),
    "static": (StaticTable, {"pose": "position"}),
    "move": (ExperimentTable, {"start": "position", "goal": "position"}),
    "tour": (TourTable, {"stops": "positions"}),
}


def validated(raw: dict[str, Any], machine: Machine) -> ExperimentTable:
    """Return the validated table of a file's kind; raises pydantic's ValidationError or a ComplaintError."""
    kind = raw.get("kind")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ComplaintError(("kind",), f"{'is missing' if kind is None else 'no such kind'}; write one of {', '.join(_KINDS)}")
    base, by_axis = _KINDS[kind]
    fields: dict[str, Any] = {name: _field(machine, what) for name, what in by_axis.items()}
    return create_model(f"{base.__name__}OfMachine", __base__=base, **fields).model_validate(raw)


def dimension_of(unit: str) -> str:
    """Return the dimension to which a unit belongs."""
    return next(dimension for dimension, units in UNITS.items() if unit in units)


def _field(machine: Machine, what: str) -> tuple[Any, Any]:
    if what == "positions":
        return tuple[_axis_table(machine, "position"), ...], ...  # type: ignore[misc]
    return _axis_table(machine, what) | None, None


def _axis_table(machine: Machine, what: str) -> type[AxisTable]:
    fields: dict[str, Any] = {}
    for units in machine.units:
        unit = units.position if what == "position" else units.effort
        value = Number if what == "position" else Positive
        fields[units.axis] = (Annotated[value | None, Quantity(dimension_of(unit))], None)
    return create_model(f"{what.capitalize()}ByAxis", __base__=AxisTable, **fields)
