"""Commands in a CAN log: targets and offsets that a master sent, by the mode in which the machine file says that a drive is commanded.

A drive adds to its target the offset of the same kind, so both are the command. The offset of torque beside a velocity or a position is the
excitation; without one, the other offset is. What is left, a velocity offset beside a position, is `velocity_offset_A`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drivers.canopen.units import units_in_data_sheet
from drivers.settings import AxisScaling, LoopMode, Node
from hil.recording.recording import Channel

TARGET_TORQUE, TARGET_POSITION, TARGET_VELOCITY = 0x6071, 0x607A, 0x60FF
POSITION_OFFSET, VELOCITY_OFFSET, TORQUE_OFFSET = 0x60B0, 0x60B1, 0x60B2
COUNTER = 2.0**32

_OF_TORQUE = {TARGET_TORQUE: "target_torque", TORQUE_OFFSET: "torque_offset"}
_OF_VELOCITY = {TARGET_VELOCITY: "target_velocity", VELOCITY_OFFSET: "velocity_offset", TORQUE_OFFSET: "torque_offset"}
_OF_POSITION = {TARGET_POSITION: "target_position", POSITION_OFFSET: "position_offset", VELOCITY_OFFSET: "velocity_offset"}
_OF_POSITION |= {TORQUE_OFFSET: "torque_offset"}


def asked_in(mode: LoopMode) -> dict[int, str]:
    """Return the objects that a drive follows in a mode, and what they ask for: `target_KIND`, or `KIND_offset`."""
    return _OF_TORQUE if mode == "torque" else _OF_VELOCITY if mode.endswith("velocity") else _OF_POSITION


def commands(
    asked: Mapping[str, np.ndarray], scaling: AxisScaling, drive: Node, counts: np.ndarray | None, offset: float, effort_unit: str
) -> dict[str, Channel]:
    """Return `command`, `excitation` and `velocity_offset` of an axis, as far as they were sent.

    Parameters
    ----------
    asked : mapping of str to (N,) array
        Raw values, by `asked_in`; NaN where none came.
    scaling : AxisScaling
    drive : Node
        Its data sheet says the unit of velocities, unless the machine file does.
    counts : (N,) array or None
        Unwrapped position actual values: targets are continued over the end of the counter with them.
    offset : float
        Of the motor-side position, by homing [rad or m].
    effort_unit : str

    Raises
    ------
    ConfigurationRefusedError
        See `drivers.canopen.units.units_of`.
    """
    position_unit = scaling.position_unit
    scaled: dict[str, Channel] = {}
    for name, raw in asked.items():
        kind, is_target = name.removeprefix("target_").removesuffix("_offset"), name.startswith("target_")
        if kind == "torque":
            scaled[name] = Channel(effort_unit, scaling.sign * scaling.rated * raw / 1000.0)
        elif kind == "velocity":
            per_unit = scaling.sign * scaling.position_resolution / units_in_data_sheet(drive, scaling).velocity
            scaled[name] = Channel(f"{position_unit}/s", per_unit * raw)
        else:
            near = raw if not is_target or counts is None else _continued(raw, counts)
            home = offset if is_target else 0.0
            scaled[name] = Channel(position_unit, scaling.sign * scaling.position_resolution * near + home)
    return _named(scaled, "torque" if scaling.mode == "torque" else "velocity" if scaling.mode.endswith("velocity") else "position")


def _named(scaled: dict[str, Channel], kind: str) -> dict[str, Channel]:
    found: dict[str, Channel] = {}
    target, own = scaled.get(f"target_{kind}"), scaled.pop(f"{kind}_offset", None)
    if target is None and kind == "torque" and own is not None:  # a drive that takes all of its torque as an offset
        return {"command": own}
    if target is not None:
        found["command"] = target if own is None else Channel(target.unit, target.values + own.values)
    if (torque := scaled.get("torque_offset", own)) is not None:
        found["excitation"] = torque
    if kind == "position" and "velocity_offset" in scaled:
        found["velocity_offset"] = scaled["velocity_offset"]
    return found


def _continued(target: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return targets in the turn of the counter in which they are nearest to the position; where that is missing, to the last one."""
    known = np.flatnonzero(np.isfinite(counts))
    if not known.size:
        return target
    latest = np.maximum(np.searchsorted(known, np.arange(len(counts)), side="right") - 1, 0)
    near = counts[known[latest]]
    continued: np.ndarray = target + COUNTER * np.round((near - target) / COUNTER)
    return continued
