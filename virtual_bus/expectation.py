"""What a machine file makes of one instant of a motion that its axes' encoders show: efforts of drives, readings of IMUs."""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.dispatch import compiled_effects
from virtual_bus.effects.motion import FrictionOf, ReactionOf
from virtual_bus.inverse_dynamics import along_sources, efforts, readings, rub
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.records import Equations

SCRATCH_ROWS = 8
"""Of a motion: position, speed, acceleration, deviation of the speed, given effort; needed effort, friction, its variance."""

ENTRY_POINT = '''"""Generated: what is expected of one plant at an instant of a motion; do not edit."""

from EFFECTS import friction_of, reaction_of
from PLANT import equations, imu

from virtual_bus import expectation
from virtual_bus.compilation.jit import compiled_and_cached


@compiled_and_cached
def expect(model, work, means, joints, gears, scale, motion, of_axes, of_imus):
    expectation.expect(
        equations, friction_of, reaction_of, imu, model[0], work[0], means, joints, gears, scale, motion, of_axes, of_imus
    )
'''


def expecting(plant: CompiledPlant) -> Callable[..., None]:
    """Return `expect` of a plant, compiled once and cached; its first arguments are the records of model and scratch memory."""
    sources = along_sources() + inspect.getsource(sys.modules[__name__])
    found: Callable[..., None] = plant.fuse("expected", ENTRY_POINT.replace("EFFECTS", compiled_effects().__name__), sources).expect
    return found


@compiled
def expect(
    equations: Equations, friction_of: FrictionOf, reaction_of: ReactionOf, imu: Equations, model: np.record, work: np.record,
    means: np.ndarray, joints: np.ndarray, gears: np.ndarray, scale: np.ndarray, motion: np.ndarray, of_axes: np.ndarray,
    of_imus: np.ndarray,
) -> None:  # fmt: skip
    """Write what drives and IMUs give at one instant of a motion that is known by its axes alone; other joints rest.

    Parameters
    ----------
    means : (8, axes) array
        Position, speed and acceleration, of motor side and link each; by how much the motor side's speed is unsure; the drive's effort.
    joints, gears : (axes,) arrays of int
        The joint that moves as an axis's motor side, and the one that moves as its link does beyond that, -1 without one.
    scale : (axes,) array
        Joint effort in one of the drive's unit.
    motion : (SCRATCH_ROWS, 1, n) array
        Scratch.
    of_axes : (2, axes) array
        Overwritten by efforts, friction included, and their standard deviations [drive's unit].
    of_imus : (1, 6 imus) array
        Overwritten.
    """
    for row in range(motion.shape[0]):
        for j in range(motion.shape[2]):
            motion[row, 0, j] = 0.0
    for axis in range(len(joints)):
        j, gear = joints[axis], gears[axis]
        for order in range(3):
            motion[order, 0, j] = means[2 * order, axis]
        motion[3, 0, j], motion[4, 0, j] = means[6, axis], scale[axis] * means[7, axis]
        if gear >= 0:
            for order in range(3):
                motion[order, 0, gear] = means[2 * order + 1, axis] - means[2 * order, axis]
    efforts(equations, reaction_of, model, work, motion[0], motion[1], motion[2], motion[5])
    rub(equations, friction_of, model, work, motion[0], motion[1], motion[3], motion[4], motion[6], motion[7])
    readings(imu, model, work, motion[0], motion[1], motion[2], of_imus)
    for axis in range(len(joints)):
        j = joints[axis]
        of_axes[0, axis] = (motion[5, 0, j] + motion[6, 0, j]) / scale[axis]
        of_axes[1, axis] = math.sqrt(motion[7, 0, j]) / scale[axis]
