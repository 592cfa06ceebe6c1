"""MATLAB files (`.mat`, up to version 7): vectors of equal length as channels of a machine whose file gives the units."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.errors import RecordingError
from hil.recording.mat5 import Mat5Error, numeric_arrays
from hil.recording.metadata import machine_table
from hil.recording.model import Channel, Recording

if TYPE_CHECKING:
    from hil.machine.model import Machine

EMPS_NAMES = {"t": "time", "qg": "reference", "qm": "position", "vir": "command", "pulses_N": "excitation"}
"""Variables of the Electro-Mechanical Positioning System benchmark (Janot, Gautier, Brunot 2019) and their channels."""

FIXED_UNITS = {
    "time": "s",
    **dict.fromkeys(("imu_x", "imu_y", "imu_z"), "m/s^2"),
    **dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), "rad/s"),
    "imu_time": "s",
    "imu_counter": "",
    "sync_lateness": "s",
    "work_time": "s",
    "exposure_id": "",
}
"""Units of channels that belong to no axis."""

_POSITIONS = ("reference", "position", "link_position")


def read_mat(path: Path, machine: Machine | None, names: Mapping[str, str] | None = None) -> Recording:
    """Read a MATLAB file.

    Parameters
    ----------
    path : Path
    machine : Machine
        Gives axes and units.
    names : mapping, optional
        Variable of the file -> channel. Without it, variables with a channel's name are taken, or those of the EMPS benchmark.

    Raises
    ------
    RecordingError
        The file is no MATLAB file of this version, there is no machine, a variable is missing or no vector of numbers, or vectors differ
        in length.
    """
    if machine is None:
        raise RecordingError(f"{path}: a .mat says neither machine nor units; name the machine with --machine")
    variables = _load(path)
    names = dict(names) if names is not None else _known_names(variables, machine, path)
    missing = [variable for variable in names if variable not in variables]
    if missing:
        raise RecordingError(f"{path}: no variable {missing[0]}; it has {', '.join(variables)}")
    channels = {channel: Channel(_unit(channel, machine, path), _vector(variables[name], name, path)) for name, channel in names.items()}
    others = {name: value for name, value in variables.items() if name not in names}
    constants = {name: value.item() for name, value in others.items() if value is not None and value.size == 1}
    try:
        return Recording(channels, {"machine": machine_table(machine), "source": {"file": path.name, "constants": constants}})
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _load(path: Path) -> dict[str, np.ndarray | None]:
    try:
        return numeric_arrays(path.read_bytes())
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None
    except Mat5Error as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _known_names(variables: Mapping[str, np.ndarray | None], machine: Machine, path: Path) -> dict[str, str]:
    if "time" in variables:
        return {name: name for name, value in variables.items() if value is not None and value.size > 1}
    if {"t", "qg", "qm", "vir"} <= variables.keys() and len(machine.axes) == 1:
        axis = machine.axes[0]
        known = {name: quantity for name, quantity in EMPS_NAMES.items() if name in variables}
        return {name: quantity if quantity == "time" else f"{quantity}_{axis}" for name, quantity in known.items()}
    raise RecordingError(f"{path}: its variables ({', '.join(variables)}) are not channels' names; say which is which, such as t=time")


def _vector(value: np.ndarray | None, name: str, path: Path) -> np.ndarray:
    if value is None or value.ndim != 2 or min(value.shape) != 1:
        raise RecordingError(f"{path}: variable {name} is no vector of numbers")
    return value.ravel().astype(np.float64)


def _unit(channel: str, machine: Machine, path: Path) -> str:
    """Return the unit of a channel of this machine."""
    if channel in FIXED_UNITS:
        return FIXED_UNITS[channel]
    axis = machine.axis_of_channel(channel)
    if axis is None:
        raise RecordingError(f"{path}: {channel} is no channel of machine {machine.name} with axes {', '.join(machine.axes)}")
    units, quantity = machine.units[machine.axis_index(axis)], channel.removesuffix(f"_{axis}")
    if quantity in {"statusword", "temperature", "data_age"}:
        return {"statusword": "", "temperature": "degC", "data_age": "s"}[quantity]
    return units.position if quantity in _POSITIONS or quantity == "reference_raw" else units.effort
