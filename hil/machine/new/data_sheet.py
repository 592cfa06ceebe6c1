"""What the data sheets (EDS) of drives and link encoders say for a machine file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from drivers.canopen.eds import load_object_dictionary
from drivers.errors import ProtocolError
from hil.errors import UnusableInputError
from hil.machine.build_bus import EDS_FOLDER
from hil.machine.new.draft import DraftAxis, Value

ROLES = {402: "drive", 406: "encoder"}
"""Profile in the low word of the device type (1000h), and what such a device is to a machine file."""

FIRST_NODE = {"drive": 1, "encoder": 11}


def add_nodes(axes: Sequence[DraftAxis], sheets: Sequence[Path], folder: Path) -> None:
    """Give every axis its drive, and its link encoder where there are sheets of encoders: one for all, or one for each in their order.

    Parameters
    ----------
    axes : sequence of DraftAxis
    sheets : sequence of Path
        EDS files, or names of shipped ones.
    folder : Path
        Of the machine file, from which their paths are written.

    Raises
    ------
    UnusableInputError
        A sheet is of another kind of device, or there are too many or too few.
    """
    by_role: dict[str, list[Path]] = {"drive": [], "encoder": []}
    for sheet in sheets:
        by_role[_role(_path(sheet))].append(_path(sheet))
    names = ", ".join(axis.name for axis in axes)
    for role, paths in by_role.items():
        if len(paths) not in ((1, len(axes)) if role == "drive" else (0, 1, len(axes))):
            right = f"one {role}'s for all axes, or one for each in their order ({names}), would be right"
            raise UnusableInputError(f"--eds: {len(paths)} data sheets of {role}s; {right}")
        for number, axis in enumerate(axes):
            if paths:
                node = _values(paths[number if len(paths) > 1 else 0], FIRST_NODE[role] + number, folder)
                axis.node, axis.link = (node, axis.link) if role == "drive" else (axis.node, node)


def _path(sheet: Path) -> Path:
    shipped = EDS_FOLDER / sheet.name
    return shipped if not sheet.exists() and shipped.exists() else sheet


def _role(path: Path) -> str:
    try:
        dictionary = load_object_dictionary(path, 1)
    except ProtocolError as error:
        raise UnusableInputError(f"--eds {error}") from None
    kind = dictionary.get_variable(0x1000)
    profile = int(kind.default or 0) & 0xFFFF if kind is not None else 0
    if profile not in ROLES:
        raise UnusableInputError(f"{path}: its device type (1000h) is of profile {profile}; a drive (402) or an encoder (406) is right")
    return ROLES[profile]


def _values(path: Path, number: int, folder: Path) -> dict[str, Value]:
    dictionary = load_object_dictionary(path, number)
    written = path.name if path.parent == EDS_FOLDER else Path(os.path.relpath(path, folder)).as_posix()
    values = {"node_id": Value(number, "in the order of the axes"), "eds": Value(written)}
    for key, subindex in (("vendor_id", 1), ("product_code", 2), ("revision_number", 3)):
        known = dictionary.get_variable(0x1018, subindex)
        if known is not None and known.default is not None:
            values[key] = Value(int(known.default), "of the data sheet", is_known=True)
    effort = "current_actual_value" if 0x6078 in dictionary else "torque_actual_value"
    values["measured"] = Value(effort)
    return values
