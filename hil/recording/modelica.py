"""Result files of Modelica tools (`.mat` of OpenModelica, Dymola, SystemModeler): trajectories by their Modelica names.

A file of MATLAB's level 4 with matrices Aclass, name, description, dataInfo, data_1 and data_2 (OpenModelica User's Guide, The MATv4 Result
File Format). dataInfo says of each name its table and its column in it, negative for its opposite; the first of data_2 is time. A
description ends with the unit, `[rad]`, or `[rad|deg]` with that of display behind it. At an event there are two rows of one time, of which
the second counts.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from hil.recording.channels import is_unit
from hil.recording.mat5 import MatError
from hil.recording.naming import Column, Columns

CLASS = "Aclass"
_NEEDED = ("name", "description", "dataInfo", "data_2")
_TRAJECTORY = "Atrajectory"
_TRANSPOSED = "binTrans"
_UNIT = re.compile(r"\[([^\[\]|]+)(?:\|[^\[\]]*)?\]\s*$")
_TIME, _PARAMETERS = 0, 1


def is_modelica(matrices: Mapping[str, np.ndarray]) -> bool:
    """Return whether a file's matrices are those of a trajectory."""
    return CLASS in matrices and _texts(matrices[CLASS])[:1] == [_TRAJECTORY]


class Modelica(NamedTuple):
    """What a result holds: trajectories, each with its unit where the file says one, and what was left out."""

    columns: Columns
    left_out: list[str]


def modelica_result(matrices: Mapping[str, np.ndarray]) -> Modelica:
    """Return the trajectories of a result.

    Raises
    ------
    MatError
        A matrix is missing, or the tables do not fit together.
    """
    if missing := [name for name in _NEEDED if name not in matrices]:
        raise MatError(f"a Modelica result without {', '.join(missing)}")
    turned = _TRANSPOSED in _texts(matrices[CLASS])
    name, description, info, table = (matrices[key].T if turned else matrices[key] for key in _NEEDED)
    names, descriptions, places = _texts(name), _texts(description), np.asarray(info, dtype=np.int64)
    if places.shape[0] != len(names) or places.ndim != 2 or places.shape[1] < 2 or table.ndim != 2 or not table.size:
        raise MatError(f"a Modelica result whose tables do not fit: {len(names)} names, dataInfo of shape {places.shape}")
    if np.any(np.abs(places[places[:, 0] != _PARAMETERS, 1]) > table.shape[1]) or np.any(places[:, 1] == 0):
        raise MatError(f"a Modelica result whose dataInfo names columns beyond the {table.shape[1]} of data_2")
    time_s = table[:, 0].astype(np.float64)
    last = np.concatenate([np.diff(time_s) != 0.0, [True]])
    columns = {"time": Column(time_s[last], "s")}
    parameters = 0
    for number, (one, (where, place)) in enumerate(zip(names, places[:, :2].tolist(), strict=True)):
        if where == _PARAMETERS:
            parameters += 1
        elif where != _TIME and one.lower() != "time":
            values = np.sign(place) * table[last, abs(place) - 1].astype(np.float64)
            columns[one] = Column(values, _unit(descriptions[number] if number < len(descriptions) else ""))
    notes = [f"{parameters} constants of the model, which are no signals"] if parameters else []
    events = int(np.count_nonzero(~last))
    return Modelica(Columns(columns), [*notes, *([f"{events} rows before events, of whose time there is another"] if events else [])])


def _unit(description: str) -> str | None:
    """Return the unit at the end of a description, if it is one that a channel can have."""
    found = _UNIT.search(description)
    return found[1].strip() if found and is_unit(found[1].strip()) else None


def _texts(letters: np.ndarray) -> list[str]:
    """Return the rows of a matrix of letters."""
    rows = np.clip(np.nan_to_num(letters), 0, 255).astype(np.uint8)
    return [bytes(row).decode("utf-8", errors="replace").rstrip(" \0") for row in rows]
