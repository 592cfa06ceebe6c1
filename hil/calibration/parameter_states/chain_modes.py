"""A chain's file with its modes: elastic joints on a chain of Denavit-Hartenberg rows, and gravity on what each carries."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from controllers.models.denavit_hartenberg import DenavitHartenberg
from controllers.models.flexible_chain import AT_PANEL, IN_CHAIN, ElasticJoint, FlexibleChain
from controllers.models.gravity import GravityTree
from controllers.models.motions import frames_of
from controllers.models.swinging_chain import PanelImu
from hil.calibration.kinematic.chain_file import read_chain
from hil.calibration.parameter_states.filter_model import SwingingMachine
from hil.errors import UnusableInputError

GRAVITY_m_s2 = (0.0, 0.0, -9.81)
SOURCE_m = (0.0, 0.0, -1.16)
VECTORS = ("axis", "point_m", "center_of_mass_m")
POSITIVE = ("frequency_Hz", "damping", "compliance_rad_Nm", "mass_kg")


def read_swinging(path: Path) -> SwingingMachine:
    """Read a chain's file (see `read_chain`) with `source_m`, `gravity_m_s2`, a table `[imu]`, and `[[mode]]` tables.

    A mode has name, row (0: the panel's mount; k: before joint k), axis, point_m (in the frame there), frequency_Hz, damping,
    compliance_rad_Nm, gain_rad_s2 (per axis, per unit of its effort), and mass_kg and center_of_mass_m of the body that hangs on it, up to
    the next joint on the way to the panel: in the panel's frame with all axes at zero. It carries the bodies beyond as well.

    Raises
    ------
    UnusableInputError
        As of `read_chain`; no mode; a key missing or of no use.
    """
    chain = read_chain(path)
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    modes = document.get("mode", [])
    if not isinstance(modes, list) or not modes or not all(isinstance(each, dict) for each in modes):
        raise UnusableInputError(f"{path}: must have a table [[mode]] for every mode of which the parameters are to be states")
    count = len(chain.joints)
    names = []
    for number, mode in enumerate(modes, start=1):
        where = f"{path}: mode {number}"
        name, row = mode.get("name"), mode.get("row")
        if not isinstance(name, str) or not name or name in names:
            raise UnusableInputError(f"{where}: name = {name!r}: must be a text of its own")
        names.append(name)
        if isinstance(row, bool) or not isinstance(row, int) or not 0 <= row <= count + 1:
            raise UnusableInputError(f"{where}: row = {row!r}: must be a whole number from 0, the panel, to {count + 1}, the phantom")
        for key in VECTORS:
            vector(where, key, mode.get(key), 3)
        for key in POSITIVE:
            value = mode.get(key)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < np.inf:
                raise UnusableInputError(f"{where}: {key} = {value!r}: must be a positive number")
        if mode["damping"] >= 1.0:
            raise UnusableInputError(f"{where}: damping = {mode['damping']:g}: must be a ratio below 1; a mode swings")
        vector(where, "gain_rad_s2", mode.get("gain_rad_s2"), count)
        if not np.linalg.norm(mode["axis"]) > 0.0:
            raise UnusableInputError(f"{where}: axis = {mode['axis']}: must not be zero")
    gravity = vector(str(path), "gravity_m_s2", document.get("gravity_m_s2", GRAVITY_m_s2), 3)
    source = vector(str(path), "source_m", document.get("source_m", SOURCE_m), 3)
    sensor = document.get("imu", {})
    if not isinstance(sensor, dict):
        raise UnusableInputError(f"{path}: imu = {sensor!r}: must be a table with position_m")
    place = vector(f"{path}: imu", "position_m", sensor.get("position_m", (0.0, 0.0, 0.0)), 3)
    return SwingingMachine(
        chain=_flexible(chain, sorted(modes, key=lambda each: each["row"]), source, gravity),
        imu=PanelImu(place, np.eye(3)),
        gravity_m_s2=gravity,
        swinging=tuple(range(len(modes))),
        frequency_Hz=np.array([each["frequency_Hz"] for each in sorted(modes, key=lambda each: each["row"])]),
        damping=np.array([each["damping"] for each in sorted(modes, key=lambda each: each["row"])]),
        gain=np.array([each["gain_rad_s2"] for each in sorted(modes, key=lambda each: each["row"])], dtype=float),
    )


def vector(where: str, key: str, value: object, size: int) -> np.ndarray:
    """Return a vector from a file; raise UnusableInputError where it is none of this size."""
    try:
        found = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (size,) or not np.isfinite(found).all():
        raise UnusableInputError(f"{where}: {key} = {value!r}: must be {size} numbers")
    return found


def _flexible(chain: DenavitHartenberg, modes: list[dict[str, Any]], source: np.ndarray, gravity: np.ndarray) -> FlexibleChain:
    """Return the chain with its elastic joints and the tree of what gravity pulls, from the world to the panel."""
    count = len(chain.joints)
    rows = chain.motions(np.zeros((1, count)))
    before = [frames_of([motion for row in rows[:k] for motion in row], 1)[-1][0] for k in range(len(rows))]
    to_world = np.linalg.inv(frames_of([motion for row in rows for motion in row], 1)[-1][0])
    elastic = tuple(
        ElasticJoint(
            mode["name"],
            AT_PANEL if mode["row"] == 0 else IN_CHAIN,
            mode["row"],
            np.array(mode["axis"], dtype=float) / np.linalg.norm(mode["axis"]),
            np.array(mode["point_m"], dtype=float),
            True,
            count + k,
        )
        for k, mode in enumerate(modes)
    )
    lines: list[tuple[np.ndarray, np.ndarray, int, float, np.ndarray]] = []  # direction, point, coordinate, mass, its centre; in the world
    nothing = np.zeros(3)
    for row in range(count + 1, -1, -1):
        frame = to_world @ before[row]
        if 1 <= row <= count:  # a joint turns what is behind it, seen from the panel: in the world it turns the panel the other way
            lines.append((-frame[:3, 2], frame[:3, 3], row - 1, 0.0, nothing))
        for joint, mode in zip(elastic, modes, strict=True):
            if joint.row == row:
                center = to_world[:3, :3] @ np.array(mode["center_of_mass_m"], dtype=float) + to_world[:3, 3]
                point = frame[:3, :3] @ joint.point_m + frame[:3, 3]
                lines.append((frame[:3, :3] @ joint.axis, point, joint.coordinate, float(mode["mass_kg"]), center))
    points = np.array([line[1] for line in lines])
    tree = GravityTree(
        parent=np.arange(len(lines)) - 1,
        position_m=np.diff(points, axis=0, prepend=np.zeros((1, 3))),
        orientation=np.tile(np.eye(3), (len(lines), 1, 1)),
        axis=np.array([line[0] for line in lines]),
        revolute=np.ones(len(lines), dtype=bool),
        coordinate=np.array([line[2] for line in lines]),
        mass_kg=np.array([line[3] for line in lines]),
        center_of_mass_m=np.array([line[4] - line[1] if line[3] else nothing for line in lines]),
        gravity_m_s2=gravity,
    )
    return FlexibleChain(chain, tuple(range(count)), source, elastic, np.array([float(mode["compliance_rad_Nm"]) for mode in modes]), tree)
