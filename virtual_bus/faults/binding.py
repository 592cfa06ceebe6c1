"""From the tables of a faults file to faults bound to places of a machine, and from these into an emulated machine."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from virtual_bus.errors import FaultError
from virtual_bus.faults.condition import Condition, parse_condition
from virtual_bus.faults.fault import PLACES, FaultKind, FaultSetting, Parameter, Place
from virtual_bus.faults.machine import FaultyMachine, quantity_names
from virtual_bus.faults.registry import fault_kinds
from virtual_bus.faults.schedule import Injection

RESERVED = ("name", "at", "when", "from_s", "for_s")
LONGEST_S = 1e6
"""Eleven days: nothing is emulated for longer."""


@dataclass(frozen=True)
class FaultPlaces:
    """The places of one machine at which faults may act.

    Parameters
    ----------
    axes, braked, watched, thermometers, linked : tuple of str
        All axes; those with a brake, with a brake feedback at the I/O, with a temperature sensor there, with a link encoder.
    drives, encoders, short : tuple of str
        Names of nodes; `short` of those that send a PDO of fewer than eight bytes.
    imu, io : bool
        Whether the machine has one.
    producer : tuple of str
        The device that sends SYNC; empty where the bench does.
    """

    axes: tuple[str, ...]
    braked: tuple[str, ...]
    watched: tuple[str, ...]
    thermometers: tuple[str, ...]
    linked: tuple[str, ...]
    drives: tuple[str, ...]
    encoders: tuple[str, ...]
    short: tuple[str, ...]
    imu: bool
    io: bool
    producer: tuple[str, ...] = ()

    def of(self, place: Place) -> tuple[str, ...]:
        """Return what `at` may be for a kind of place."""
        return {
            "axis": self.axes,
            "brake": self.braked,
            "feedback": self.watched,
            "thermometer": self.thermometers,
            "drive": self.drives,
            "encoder": self.encoders,
            "node": (*self.drives, *self.encoders),
            "short PDO": self.short,
            "imu": ("imu",) if self.imu else (),
            "io": ("io",) if self.io else (),
            "bus": ("bus",),
            "producer": self.producer,
            "process": (),
        }[place]

    @property
    def quantities(self) -> frozenset[str]:
        """Quantities that a condition may name."""
        return quantity_names(self.axes, self.linked)


def bind_faults(entries: Sequence[Mapping[str, object]], places: FaultPlaces, label: str) -> tuple[FaultSetting, ...]:
    """Check the tables of a faults file against the list of faults and a machine.

    Parameters
    ----------
    entries : sequence of mappings
        One `[[fault]]` each.
    places : FaultPlaces
    label : str
        What messages call the file.

    Raises
    ------
    FaultError
        One line: the file, which fault, which key, what is wrong and what would be right.
    """
    return tuple(_bind(entry, places, f"{label}: fault {number}") for number, entry in enumerate(entries, start=1))


def _bind(entry: Mapping[str, object], places: FaultPlaces, where: str) -> FaultSetting:
    name = entry.get("name")
    kind = fault_kinds().get(name) if isinstance(name, str) else None
    if kind is None:
        raise FaultError(f"{where}: name = {name!r}: no such fault; `isocenter faults list` names all")
    here = f"{where} ({kind.name})"
    if kind.begin is None:
        raise FaultError(f"{here}: is a fault of the bench's processes, which the emulated machine cannot have; leave it out")
    keys = {parameter.key: parameter for parameter in kind.parameters}
    for key in entry:
        if key not in keys and key not in RESERVED:
            raise FaultError(f"{here}: {key}: unknown key; there is {', '.join((*RESERVED, *keys))}")
    at = _place(entry.get("at"), kind, places, here)
    from_s, for_s = _seconds(entry, "from_s", 0.0, here), _seconds(entry, "for_s", math.inf, here)
    if for_s == 0.0:
        raise FaultError(f"{here}: for_s = {entry['for_s']!r}: must be more than 0; leave it out for a fault that stays")
    values = {parameter.name: _value(entry, key, parameter, here) for key, parameter in keys.items()}
    return FaultSetting(kind.name, at, values, _condition(entry, places, here), from_s, for_s)


def _place(at: object, kind: FaultKind, places: FaultPlaces, here: str) -> str:
    allowed = places.of(kind.at)
    if at is None and len(allowed) == 1:
        return allowed[0]
    if at not in allowed:
        there = f"there is {', '.join(allowed)}" if allowed else "this machine has none"
        raise FaultError(f"{here}: at = {at!r}: must be {PLACES[kind.at]}; {there}")
    assert isinstance(at, str)
    return at


def _condition(entry: Mapping[str, object], places: FaultPlaces, here: str) -> Condition | None:
    if "when" not in entry:
        return None
    text = entry["when"]
    if not isinstance(text, str):
        raise FaultError(f'{here}: when = {text!r}: must be text, such as "abs(speed_{places.axes[0]}) > 0.3"')
    try:
        return parse_condition(text, places.quantities, places.axes)
    except FaultError as error:
        raise FaultError(f"{here}: {error}") from None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _seconds(entry: Mapping[str, object], key: str, default: float, here: str) -> float:
    if key not in entry:
        return default
    value = entry[key]
    if not isinstance(value, int | float) or not _is_number(value) or not 0.0 <= value <= LONGEST_S:
        raise FaultError(f"{here}: {key} = {value!r}: must be seconds, from 0 to {LONGEST_S:g}")
    return float(value)


def _value(entry: Mapping[str, object], key: str, parameter: Parameter, here: str) -> float:
    value = entry.get(key, parameter.default)
    good = isinstance(value, int | float) and _is_number(value) and parameter.low <= value <= parameter.high
    if not isinstance(value, int | float) or not good or (parameter.whole and value != int(value)):
        what = "a whole number" if parameter.whole else "a number"
        bounds = f"{parameter.low:g} to {parameter.high:g} {parameter.unit}".rstrip()
        raise FaultError(f"{here}: {key} = {value!r}: must be {what} from {bounds}: {parameter.description}")
    return float(value)


def as_entries(settings: Iterable[FaultSetting]) -> list[dict[str, object]]:
    """Return the tables of a faults file: the inverse of `bind_faults`. Values that are the defaults are left out."""
    entries = []
    for setting in settings:
        entry: dict[str, object] = {"name": setting.name, "at": setting.at}
        if setting.when is not None:
            entry["when"] = str(setting.when)
        if setting.from_s:
            entry["from_s"] = setting.from_s
        if math.isfinite(setting.for_s):
            entry["for_s"] = setting.for_s
        for parameter in fault_kinds()[setting.name].parameters:
            if setting.parameters[parameter.name] != parameter.default:
                entry[parameter.key] = setting.parameters[parameter.name]
        entries.append(entry)
    return entries


def inject(machine: FaultyMachine, settings: Iterable[FaultSetting]) -> None:
    """Put faults on the schedule of an emulated machine, before it is powered on."""
    for setting in settings:
        begin = fault_kinds()[setting.name].begin
        assert begin is not None  # `bind_faults` has refused the others
        act = partial(begin, machine, setting.at, dict(setting.parameters))
        machine.inject(Injection(setting.label, act, setting.when, setting.from_s, setting.for_s))
