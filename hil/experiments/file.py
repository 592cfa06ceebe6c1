"""Experiment files (TOML), as `isocenter run` reads and `diagnose` proposes them. Keys end in their unit, as in machine files."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from controllers.excitation_lines import Band
from hil.errors import ExperimentError
from hil.experiments.file_tables import AxisTable, ExperimentTable, MultisineTable, PeriodicTable, ScanTable, dimension_of, validated
from hil.experiments.file_text import experiment_text
from hil.experiments.jog import Jog, JogOnly
from hil.experiments.move import Move
from hil.experiments.multisine import Multisine
from hil.experiments.plan import Experiment
from hil.experiments.scan import Scan
from hil.experiments.static import Static
from hil.experiments.tour import Tour
from hil.files.regular import check_regular
from hil.machine import Machine
from hil.machine.messages import ComplaintError, from_validation, one_line
from hil.machine.table import Table

# field of a table -> field of the experiment, where the latter carries its SI unit
_NAMES = {
    "period": "period_s",
    "dwell": "dwell_s",
    "duration": "seconds",
    "amplitude": "amplitude_A",
    "amplitudes": "amplitude_A",
    "band": "lines",
}
_PER_TIME = {"speed": "_s", "acceleration": "_s2"}
_JOG_NAMES = {"amplitude": "amplitude_rad", "frequency": "frequency_Hz"}
_BAND_NAMES = {"low": "low_Hz", "high": "high_Hz", "dense": "dense_Hz"}


def read_experiment(path: str | Path, machine: Machine) -> Experiment:
    """Read an experiment for a machine. Omitted keys have their defaults, except the jog: without a table [jog] there is none.

    Raises
    ------
    ExperimentError
        The file cannot be used; one line names file, key, value, the fault and what would be right.
    """
    check_regular(Path(path), ExperimentError)
    try:
        text = Path(path).read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise ExperimentError(f"{path}: byte {error.start} is no UTF-8; TOML files are UTF-8 text") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null byte
        raise ExperimentError(f"{path}: {getattr(error, 'strerror', None) or 'cannot be read'}") from None
    return experiment_from_text(text, machine, str(path))


def experiment_from_text(text: str, machine: Machine, file: str = "experiment") -> Experiment:
    """Read an experiment from TOML text; `file` is its name in errors. Raises as `read_experiment`."""
    try:
        raw = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # RecursionError: brackets nested too deep
        raise ExperimentError(f"{file}: no valid TOML: {' '.join(str(error).split())}") from None
    try:
        return _experiment(validated(raw, machine), machine)
    except ValidationError as error:
        raise ExperimentError(one_line(file, raw, from_validation(error))) from None
    except ComplaintError as complaint:
        raise ExperimentError(one_line(file, raw, complaint)) from None


def write_experiment(experiment: Experiment, machine: Machine, path: str | Path) -> None:
    """Write a file that `read_experiment` reads back equal.

    Raises
    ------
    ExperimentError
        The file cannot be written.
    """
    try:
        Path(path).write_text(experiment_text(experiment, machine), encoding="utf-8")
    except OSError as error:
        raise ExperimentError(f"{path}: {error.strerror}") from None


def _experiment(table: ExperimentTable, machine: Machine) -> Experiment:
    for first, second in (("lines", "band"), ("amplitude", "amplitudes")):
        if first in type(table).model_fields and table.has(first) and table.has(second):
            raise ComplaintError((second,), f"says the same as {table.key(first)}; keep one of them")
    given = _given(table, _NAMES)
    given.pop("format")
    match given.pop("kind"):
        case "multisine":
            assert isinstance(table, MultisineTable)
            axes = given.get("axes") or machine.axes
            if table.has("amplitude"):
                _check_dimension(table, "amplitude", axes, machine, ())
            if table.band is not None:
                given["lines"] = Band(**_given(table.band, _BAND_NAMES))
            return Multisine(**(given | {"jog": _jog(table.jog, axes, machine) if table.jog is not None else None}))
        case "jog":
            assert isinstance(table, PeriodicTable)
            if table.jog is not None:
                given["jog"] = _jog(table.jog, given.get("axes") or machine.axes, machine)
            return JogOnly(**given)
        case "scan":
            assert isinstance(table, ScanTable)
            for name in ("start", "stop", "speed", "acceleration"):
                _check_dimension(table, name, (table.axis,), machine, ())
            return Scan(**given)
        case "static":
            return Static(**given)
        case "tour":
            return Tour(**(given | {"stops": tuple(stop.by_axis() for stop in given["stops"])}))
        case _:
            return Move(start=given.get("start", {}), goal=given.get("goal", {}))


def _given(table: Table, names: dict[str, str]) -> dict[str, Any]:
    """Return the values in the file by the experiment's field names."""
    found = {}
    for name in type(table).model_fields:
        if table.has(name):
            value = getattr(table, name)
            found[names.get(name, name)] = value.by_axis() if isinstance(value, AxisTable) else value
    return found


def _jog(table: Table, axes: Iterable[str], machine: Machine) -> Jog:
    fields = _given(table, _JOG_NAMES)
    _check_dimension(table, "amplitude", fields.get("axes") or axes, machine, ("jog",))
    return Jog(**fields)


def _check_dimension(table: Table, name: str, axes: Iterable[str], machine: Machine, where: tuple[str, ...]) -> None:
    """Require angles on revolute axes, lengths on prismatic ones, and the drive's unit for efforts."""
    units = {each.axis: each for each in machine.units}
    for axis in axes:
        if axis not in units:
            place = "axis" if table.has("axis") else "axes"
            raise ComplaintError((*where, place), f"{machine.name} has no axis {axis}; it has {', '.join(units)}")
        unit = units[axis].effort if name == "amplitude" and not where else units[axis].position
        per = _PER_TIME.get(name, "")
        found = table.dimension(name)
        if found is not None and found != dimension_of(unit + per):
            raise ComplaintError((*where, table.key(name)), f"{axis} takes {(unit + per).replace('_', '/')} here")
