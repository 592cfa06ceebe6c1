"""An experiment as the TOML text of an experiment file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from controllers.excitation_lines import Band
from hil.errors import ExperimentError
from hil.experiments.file_tables import FORMAT
from hil.experiments.jog import Jog, JogOnly
from hil.experiments.move import Move
from hil.experiments.multisine import Multisine
from hil.experiments.plan import Experiment
from hil.experiments.scan import Scan
from hil.experiments.static import Static
from hil.experiments.tour import Tour
from hil.files.toml_text import toml_text
from hil.machine import Machine
from hil.machine.units import UNITS


def experiment_text(experiment: Experiment, machine: Machine) -> str:
    """TOML text that reads back equal.

    Raises
    ------
    ExperimentError
        An experiment that has no file format.
    """
    match experiment:
        case Multisine():
            table = _multisine(experiment, machine)
        case JogOnly():
            table = {"kind": "jog", **_periods(experiment), "pose": _pose(experiment.pose, machine)}
            table["jog"] = _jog(experiment.jog, experiment.axes, machine)
        case Scan():
            unit = _position_unit(experiment.axis, machine)
            ends = [_position("start", experiment.start, unit), _position("stop", experiment.stop, unit)]
            table = {"kind": "scan", "axis": experiment.axis, **dict(ends), **dict([_position("speed", experiment.speed, unit, "_s")])}
            if experiment.acceleration is not None:
                table |= dict([_position("acceleration", experiment.acceleration, unit, "_s2")])
            table |= {"dwell_s": float(experiment.dwell_s), "sweeps": experiment.sweeps, "pose": _pose(experiment.pose, machine)}
        case Static():
            table = {"kind": "static", "duration_s": float(experiment.seconds), "pose": _pose(experiment.pose, machine)}
        case Move():
            table = {"kind": "move", "start": _pose(experiment.start, machine), "goal": _pose(experiment.goal, machine)}
        case Tour():
            stops = [_pose(stop, machine) for stop in experiment.stops]
            table = {"kind": "tour", "pace": float(experiment.pace), "dwell_s": float(experiment.dwell_s), "stops": stops}
        case _:
            raise ExperimentError(f"a {type(experiment).__name__} has no file format")
    return toml_text({"format": FORMAT, **table})


def _multisine(experiment: Multisine, machine: Machine) -> dict[str, Any]:
    efforts = {units.axis: units.effort for units in machine.units}
    table: dict[str, Any] = {"kind": "multisine", "experiments": experiment.experiments, **_periods(experiment)}
    table |= {"realisations": experiment.realisations, "phases": experiment.phases, "seed": experiment.seed}
    if experiment.weights is not None:
        table["weights"] = [float(weight) for weight in experiment.weights]
    if isinstance(experiment.amplitude_A, Mapping):
        table["amplitudes"] = {f"{axis}_{efforts[axis]}": float(value) for axis, value in experiment.amplitude_A.items()}
    else:
        table[f"amplitude_{efforts[(experiment.axes or machine.axes)[0]]}"] = float(experiment.amplitude_A)
    if isinstance(experiment.lines, Band):
        table["band"] = _band(experiment.lines)
    else:
        table["lines"] = list(experiment.lines)
    table["pose"] = _pose(experiment.pose, machine)
    if experiment.jog is not None:
        table["jog"] = _jog(experiment.jog, experiment.axes, machine)
    return table


def _band(band: Band) -> dict[str, Any]:
    return {
        "low_Hz": float(band.low_Hz),
        "high_Hz": float(band.high_Hz),
        "per_decade": band.per_decade,
        "dense_Hz": [[float(low), float(high)] for low, high in band.dense_Hz],
        "odd": band.odd,
        "one_free_in": band.one_free_in,
    }


def _periods(experiment: Multisine | JogOnly) -> dict[str, Any]:
    return {
        "axes": list(experiment.axes),
        "period_s": float(experiment.period_s),
        "periods": experiment.periods,
        "settle_periods": experiment.settle_periods,
    }


def _jog(jog: Jog, axes: tuple[str, ...], machine: Machine) -> dict[str, Any]:
    table: dict[str, Any] = dict(
        [_position("amplitude", jog.amplitude_rad, _position_unit((jog.axes or axes or machine.axes)[0], machine))]
    )
    if jog.line is not None:
        table["line"] = jog.line
    if jog.frequency_Hz is not None:
        table["frequency_Hz"] = float(jog.frequency_Hz)
    if jog.turn_share != 1.0:
        table["turn_share"] = float(jog.turn_share)
    return table | {"axes": list(jog.axes)}


def _pose(pose: Mapping[str, float], machine: Machine) -> dict[str, float]:
    return dict(_position(axis, value, _position_unit(axis, machine)) for axis, value in pose.items())


def _position(key: str, value: float, unit: str, per: str = "") -> tuple[str, float]:
    """Key with its unit, and the value; in degrees where that reads back to the bit."""
    value = float(value)
    if unit == "rad":
        factor = UNITS["angle"]["deg"]
        degrees = round(value / factor, 9)
        if degrees * factor == value:
            return f"{key}_deg{per}", degrees
    return f"{key}_{unit}{per}", value


def _position_unit(axis: str, machine: Machine) -> str:
    for units in machine.units:
        if units.axis == axis:
            return units.position
    raise ExperimentError(f"{machine.name} has no axis {axis!r}; it has {', '.join(machine.axes)}")
