"""MATLAB files (`.mat`) of every version, and those of Octave: vectors of equal length as channels of a machine whose file gives the units.

Vectors may be variables, fields of structures, cells, and columns or rows of matrices.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.errors import RecordingError
from hil.recording import octave_text
from hil.recording.mat4 import is_level_4, level_4_arrays, level_4_matrices
from hil.recording.mat5 import MatError, Value, numeric_arrays
from hil.recording.mat73 import MARK, hdf5_arrays
from hil.recording.metadata import machine_table
from hil.recording.modelica import Modelica, is_modelica, modelica_result
from hil.recording.naming import Column, Columns, Target, is_channel, named_channels
from hil.recording.rasters import channels_in_order
from hil.recording.recording import Recording
from hil.recording.said import listed, source_table

if TYPE_CHECKING:
    from hil.machine.machine import Machine

EMPS_NAMES = {"t": "time", "qg": "reference", "qm": "position", "vir": "command", "pulses_N": "excitation"}
"""Variables of the Electro-Mechanical Positioning System benchmark (Janot, Gautier, Brunot 2019) and their channels."""

_MOST_COLUMNS = 1000
"""Of one matrix: more columns than that are no signals."""


def read_mat(path: Path, machine: Machine | None, names: Mapping[str, Target] | None = None, part: str = "") -> Recording:
    """Read a MATLAB file.

    Parameters
    ----------
    path : Path
    machine : Machine
        Gives axes and units.
    names : mapping, optional
        Variable of the file -> channel: `q`, `log.time`, `log.signals(2).values`, `runs{3}`, `data(:,2)`, `data(2,:)`. Without it,
        variables with a channel's name are taken, or the signals of one structure whose names or labels are channels', or those of the
        EMPS benchmark.
    part : str
        Of rows of several senders those to take, as in `stamps`.

    Raises
    ------
    RecordingError
        The file is no MATLAB file, there is no machine, a variable is missing or stands for several vectors, or vectors differ in length.
    """
    if machine is None:
        raise RecordingError(f"{path}: a .mat says neither machine nor units; name the machine with --machine")
    variables = _load(path)
    if isinstance(variables, Modelica):
        return _of_modelica(variables, path, machine, names or {}, part)
    found = _columns(variables)
    if names:
        wanted = {_as_stored(name, one.channel, variables, found): one for name, one in names.items()}
    else:
        wanted = _known_names(variables, found, machine, path)
    channels, _ = named_channels(found, wanted, machine, path)
    channels, order = channels_in_order(channels, path, part)
    constants = {
        name: value.item() for name, value in variables.items() if isinstance(value, np.ndarray) and value.size == 1 and name not in wanted
    }
    whole = {name for name in found.several if name in variables and not any(one in wanted for one in found.several[name])}
    not_taken = [name for name in found.columns if name not in wanted and _base(name) not in whole]
    not_taken += [*whole, *(f"{name}, {what}" for name, what in found.others.items() if what not in (_TEXT, _NUMBER))]
    renamed = {name: one.channel for name, one in wanted.items() if name != one.channel}
    try:
        source = source_table(path, not_taken, order, renamed, constants=constants)
        return Recording(channels, {"machine": machine_table(machine), "source": source})
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


_TEXT, _NUMBER = "a text", "a single number"
_HDF5 = b"\x89HDF"
"""First bytes of an HDF5 file; MATLAB's have its own text before them."""


def _load(path: Path) -> dict[str, Value] | Modelica:
    try:
        with path.open("rb") as file:
            if file.read(len(MARK)) == MARK:
                return hdf5_arrays(path)
        content = path.read_bytes()
        if content.startswith(_HDF5):
            raise RecordingError(
                f"{path}: an HDF5 file that MATLAB did not write, such as of Octave's `save -hdf5`; `save -v7` would be right"
            )
        if content.startswith(octave_text.MARK):
            return octave_text.octave_arrays(content)
        if not is_level_4(content):
            return numeric_arrays(content)
        return modelica_result(matrices) if is_modelica(matrices := level_4_matrices(content)) else level_4_arrays(content)
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from None
    except MatError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _of_modelica(result: Modelica, path: Path, machine: Machine, names: Mapping[str, Target], part: str) -> Recording:
    """Return the trajectories that are named, or have channels' names, over the result's time."""
    found = result.columns
    wanted = dict(names) or {name: Target(name) for name in found.columns if is_channel(name, machine)}
    if not any(one.channel == "time" for one in wanted.values()):
        wanted = {"time": Target("time")} | wanted
    if len(wanted) == 1:
        others = listed([name for name in found.columns if name != "time"])
        raise RecordingError(
            f"{path}: a Modelica result with no channel's name; say which is which, such as --map NAME=position_<axis>: {others}"
        )
    channels, _ = named_channels(found, wanted, machine, path)
    channels, order = channels_in_order(channels, path, part)
    not_taken = [*(name for name in found.columns if name not in wanted), *result.left_out]
    renamed = {name: one.channel for name, one in wanted.items() if name != one.channel}
    try:
        return Recording(channels, {"machine": machine_table(machine), "source": source_table(path, not_taken, order, renamed)})
    except RecordingError as problem:
        raise RecordingError(f"{path}: {problem}") from None


def _columns(variables: Mapping[str, Value]) -> Columns:
    """Return every vector of the file; the columns of a matrix are `name(:,k)`, its rows `name(k,:)`."""
    columns: dict[str, Column] = {}
    several: dict[str, list[str]] = {}
    others: dict[str, str] = {}
    for name, value in variables.items():
        if isinstance(value, np.ndarray) and value.size > 1 and sum(n > 1 for n in value.shape) == 1:
            columns[name] = Column(value.ravel())
        elif isinstance(value, np.ndarray) and value.size > 1:
            parts = _parts(name, value)
            columns |= parts
            several[name] = list(parts)
        elif isinstance(value, np.ndarray):
            others[name] = _NUMBER if value.size else "empty"
        else:
            others[name] = _TEXT if isinstance(value, str) else "neither numbers nor text"
    for name in list(columns):
        short = re.sub(r"[({]\d+[)}]\.", ".", name)
        if short != name and short not in columns:  # of an array of structures, or of a cell array of them
            label = variables.get(name.rpartition(".")[0] + ".label")
            several.setdefault(short, []).append(f"{name} ({label})" if isinstance(label, str) else name)
    return Columns(columns, several, others)


def _parts(name: str, value: np.ndarray) -> dict[str, Column]:
    """Return the vectors along the longest side of an array; along each of them where several are as long."""
    parts: dict[str, Column] = {}
    longest = max(value.shape)
    for side in (side for side, length in enumerate(value.shape) if length == longest):
        across = [range(length) for place, length in enumerate(value.shape) if place != side]
        vectors = np.moveaxis(value, side, 0).reshape(longest, -1)
        for place, index in enumerate(itertools.islice(itertools.product(*across), _MOST_COLUMNS)):
            cells = [str(k + 1) for k in index]
            cells.insert(side, ":")
            parts[f"{name}({','.join(cells)})"] = Column(vectors[:, place])
    return parts


def _base(name: str) -> str:
    """Return the variable of a column of a matrix, other names as they are."""
    return re.sub(r"\([\d,]*:[\d,]*\)$", "", name)


def _as_stored(name: str, channel: str, variables: Mapping[str, Value], found: Columns) -> str:
    """Return the name with the brackets that the file needs: `s(2).v` of a cell array is `s{2}.v`.

    A name that stands for several signals is that of the one whose label is the channel's name, as Simulink's scopes save it.
    """
    cells = re.sub(r"\((\d+)\)", r"{\1}", name)
    if name not in found.columns and cells in found.columns:
        return cells
    meant = [one.partition(" ")[0] for one in found.several.get(name, ())]
    labelled = [one for one in meant if variables.get(one.rpartition(".")[0] + ".label") == channel]
    return labelled[0] if len(labelled) == 1 else name


def _known_names(variables: Mapping[str, Value], found: Columns, machine: Machine, path: Path) -> dict[str, Target]:
    if "time" in found.columns:
        return {name: Target(name) for name in found.columns if _base(name) == name and ("." not in name and "{" not in name)}
    if {"t", "qg", "qm", "vir"} <= variables.keys() and len(machine.axes) == 1:
        axis = machine.axes[0]
        known = {name: quantity for name, quantity in EMPS_NAMES.items() if name in variables}
        return {name: Target(quantity if quantity == "time" else f"{quantity}_{axis}") for name, quantity in known.items()}
    structures = {name.removesuffix(".time") for name in found.columns if name.endswith(".time")}
    if len(structures) == 1:
        labelled = _labelled(structures.pop(), variables, found, machine)
        if len(labelled) > 1 and len(set(labelled.values())) == len(labelled):
            return {name: Target(channel) for name, channel in labelled.items()}
    vectors = [*found.columns, *(f"{name}, {what}" for name, what in found.others.items() if what not in (_TEXT, _NUMBER))]
    raise RecordingError(f"{path}: its variables ({listed(vectors)}) are not channels' names; say which is which, such as t=time")


def _labelled(structure: str, variables: Mapping[str, Value], found: Columns, machine: Machine) -> dict[str, str]:
    """Return what a structure with time names itself: fields with channels' names, and signals with such labels, as Simulink saves them."""
    labelled: dict[str, str] = {}
    for name in found.columns:
        if not name.startswith(f"{structure}."):
            continue
        stem, _, field = name.rpartition(".")
        label = variables.get(f"{stem}.label") if field == "values" else field
        if isinstance(label, str) and is_channel(label, machine):
            labelled[name] = label
    return labelled
