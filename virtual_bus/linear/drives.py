"""Slopes of the drives, and of frictions that have one, about rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from virtual_bus.effects.motion import DriveState, JointState
from virtual_bus.effects.registry import effects, module_of
from virtual_bus.effects.table import LIMITS, targets_at_rest
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.statics import DIFFERENCE

CREEPING = 1e-7
"""rad/s or m/s: over which a friction's slope at rest is taken."""


@dataclass(frozen=True)
class DriveSlopes:
    """How the drives' efforts on their joints change, each array (axes,).

    Attributes
    ----------
    by_current : per current before supply and limit.
    by_speed : per speed of the joint, at a constant such current: what a supply gives falls with a motor's back-EMF.
    by_position : per position of the joint: what ripples, under the current that holds the machine.
    """

    by_current: np.ndarray
    by_speed: np.ndarray
    by_position: np.ndarray


def drive_slopes(plant: CompiledPlant, model: np.ndarray, joint_positions: np.ndarray, efforts: np.ndarray) -> DriveSlopes:
    """Return the slopes where the drives hold their joints with these efforts (axes,) [Nm or N]."""
    axes = len(plant.settings.drives)
    gains = plant.drive_gains(model, joint_positions)
    flowing = np.divide(efforts, gains, out=np.zeros(axes), where=gains != 0.0)
    asked = targets_at_rest(model, flowing)
    found = np.zeros((3, axes))
    for axis, joint in enumerate(plant.joint_of_axis().values()):
        position, current = float(joint_positions[joint]), float(asked[axis]) if np.isfinite(asked[axis]) else float(flowing[axis])
        step = DIFFERENCE * max(1.0, abs(current))
        by_current = [
            _passed(model, axis, DriveState(current + each, 0.0, position, model["drive_ratio"][0, axis])) for each in (step, -step)
        ]
        by_speed = [
            _passed(model, axis, DriveState(current, each, position, model["drive_ratio"][0, axis])) for each in (DIFFERENCE, -DIFFERENCE)
        ]
        found[0, axis] = gains[axis] * (by_current[0] - by_current[1]) / (2.0 * step)
        found[1, axis] = gains[axis] * (by_speed[0] - by_speed[1]) / (2.0 * DIFFERENCE)
        shift = DIFFERENCE * np.eye(plant.joints)[joint]
        ripple = plant.drive_gains(model, joint_positions + shift) - plant.drive_gains(model, joint_positions - shift)
        found[2, axis] = flowing[axis] * ripple[axis] / (2.0 * DIFFERENCE)
    return DriveSlopes(*found)


def _passed(model: np.ndarray, axis: int, state: DriveState) -> float:
    """Return what of a current passes a drive's supply and limit."""
    for row in model["limit_rows"][0, axis, :LIMITS]:
        if row[0] >= 0.0:
            effect = list(effects().values())[int(row[0])]
            passed = module_of(effect.name).limited(state, *row[1 : 1 + len(effect.parameters)].tolist())
            state = state._replace(current=passed)
    return state.current


def friction_slopes(plant: CompiledPlant, model: np.ndarray) -> np.ndarray:
    """Return the damping (n, n) that frictions have about rest besides the joints' own: of those whose level begins at nothing."""
    record, damping = model[0], np.zeros((plant.joints, plant.joints))
    for joint in range(plant.joints):
        for row in record["friction_rows"][record["friction_first"][joint] : record["friction_first"][joint + 1]]:
            damping[joint, joint] += _slope(row)
    for number in range(record["shared_count"]):
        turning = np.zeros(plant.joints)
        first, second = record["shared_joints"][number]
        turning[first] += 1.0
        turning[second] += record["share"][number]
        damping += _slope(record["shared_rows"][number]) * np.outer(turning, turning)
    return damping


def _slope(row: np.ndarray) -> float:
    effect = list(effects().values())[int(row[0])]
    values, level = row[1 : 1 + len(effect.parameters)].tolist(), module_of(effect.name).level
    moving, resting = (level(JointState(speed, 1.0, 0.0, 0.0), *values) for speed in (CREEPING, 0.0))
    slope: float = (moving - resting) / CREEPING
    return slope
