"""Files of any kinematic chain: Denavit-Hartenberg parameters as TOML, measured poses as CSV."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from controllers.models.denavit_hartenberg import FRAME_ANGLES, DenavitHartenberg
from hil.errors import UnusableInputError
from hil.files.atomic import write_atomically
from hil.files.regular import check_regular
from hil.files.toml_text import toml_text

JOINT_KEYS = ("a_m", "delta_theta_rad", "alpha_rad", "d_m", "beta")
POSE_COLUMNS = ("x [m]", "y [m]", "z [m]", "rx [rad]", "ry [rad]", "rz [rad]")
"""Where the base of the chain's far end stands, seen from its first frame: position and rotation vector."""


@dataclass(frozen=True)
class MeasuredPoses:
    """Joint angles (N, n) [rad], positions (N, 3) [m] and rotations (N, 3, 3)."""

    angles: np.ndarray
    position: np.ndarray
    rotation: np.ndarray


def read_chain(path: Path) -> DenavitHartenberg:
    """Read `[[joint]]` tables with `name` and `JOINT_KEYS` (`beta` 1 unless given), and `[frame]` with angles theta_u_rad and so on.

    Raises
    ------
    UnusableInputError
        Missing or no TOML, no joint, a key that is unknown or missing, or a value that is no number.
    """
    check_regular(path)
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UnusableInputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    joints = document.get("joint")
    if not isinstance(joints, list) or not joints or not all(isinstance(joint, dict) for joint in joints):
        raise UnusableInputError(f"{path}: must have a table [[joint]] for every joint, with name, {', '.join(JOINT_KEYS)}")
    names, rows = [], []
    for number, joint in enumerate(joints, start=1):
        where = f"{path}: joint {number}"
        name = joint.get("name")
        if not isinstance(name, str) or not name or name in names:
            raise UnusableInputError(f"{where}: name = {name!r}: must be a text of its own")
        names.append(name)
        rows.append(_numbers(where, {"beta": 1.0, **joint}, JOINT_KEYS, ("name",)))
    keys = tuple(f"{name}_rad" for name in FRAME_ANGLES)
    frame = document.get("frame", {})
    angles = _numbers(f"{path}: frame", {**dict.fromkeys(keys, 0.0), **frame}, keys)
    return DenavitHartenberg(tuple(names), np.array(rows), np.array(angles))


def write_chain(chain: DenavitHartenberg, path: Path) -> None:
    """Write a chain that `read_chain` reads back equal."""
    rows = [
        {"name": name, **dict(zip(JOINT_KEYS, map(float, row), strict=True))} for name, row in zip(chain.joints, chain.table, strict=True)
    ]
    frame = {f"{name}_rad": float(angle) for name, angle in zip(FRAME_ANGLES, chain.frame_angles, strict=True)}
    write_atomically({path: toml_text({"joint": rows, "frame": frame}).encode()})


def read_poses(path: Path, joints: tuple[str, ...]) -> MeasuredPoses:
    """Read a table with a column `NAME [rad]` or `NAME [deg]` for each joint and `POSE_COLUMNS`.

    Raises
    ------
    UnusableInputError
        Missing, a column missing, or a cell that is no number.
    """
    check_regular(path)
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UnusableInputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    header = [cell.strip() for cell in lines[0]] if lines else []
    columns, scales = [], []
    for name in joints:
        unit = next((unit for unit in ("rad", "deg") if f"{name} [{unit}]" in header), None)
        if unit is None:
            raise UnusableInputError(f"{path}: column {name} [rad] or {name} [deg] is missing; there are {', '.join(header) or 'none'}")
        columns.append(f"{name} [{unit}]")
        scales.append(1.0 if unit == "rad" else np.pi / 180.0)
    missing = [name for name in POSE_COLUMNS if name not in header]
    if missing:
        raise UnusableInputError(f"{path}: column {missing[0]} is missing; there are {', '.join(header)}")
    try:
        values = np.array([[float(line[header.index(name)]) for name in (*columns, *POSE_COLUMNS)] for line in lines[1:] if line])
    except (ValueError, IndexError):
        raise UnusableInputError(f"{path}: a cell is empty or no number") from None
    if not values.size or not np.isfinite(values).all():
        raise UnusableInputError(f"{path}: no poses, or a cell that is not finite")
    n = len(joints)
    return MeasuredPoses(values[:, :n] * scales, values[:, n : n + 3], Rotation.from_rotvec(values[:, n + 3 :]).as_matrix())


def _numbers(where: str, table: Mapping[str, Any], keys: tuple[str, ...], beside: tuple[str, ...] = ()) -> list[float]:
    unknown = sorted(set(table) - set(keys) - set(beside))
    if unknown:
        raise UnusableInputError(f"{where}: unknown key {unknown[0]}; there are {', '.join((*beside, *keys))}")
    for key in keys:
        value = table.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise UnusableInputError(f"{where}: {key} = {value!r}: must be a number")
    return [float(table[key]) for key in keys]
