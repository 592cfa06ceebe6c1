"""Subjects of a machine at one pose, and the poses for which a schedule is designed."""

from __future__ import annotations

import numpy as np

from controllers.errors import DesignError
from hil.machine import Machine
from hil.shaping.plants import closed_loop, detector_paths
from hil.shaping.shaper_design import subject
from hil.shaping.verdict import Subject
from virtual_bus.physics import Physics

SCHEDULE_POINTS = 7
"""Poses over the range of the scheduling axis: every 30 degrees of roll, between which the 8 Hz mode moves by less than half a hertz."""


def subject_at(machine: Machine, pose: np.ndarray, axis: str, output: str = "link", physics: Physics | None = None) -> Subject:
    """Return the closed loop of a machine at a pose (n_axes,), as the subject of a shaper."""
    physics = physics or Physics(machine.plant, noise=False)
    return subject(closed_loop(machine, pose, axis, output, physics), detector_paths(machine, pose, axis, physics))


def scheduled_poses(machine: Machine, pose: np.ndarray, axis: str) -> np.ndarray:
    """Return poses (n, n_axes) over the whole range of an axis, the others as in `pose`.

    Raises
    ------
    DesignError
        The axis has no finite range.
    """
    index = machine.axis_index(axis)
    limit = machine.limits[index]
    if not np.isfinite(limit.upper - limit.lower):
        raise DesignError(f"{axis} has no range in the machine file, so nothing can be scheduled over it")
    poses = np.tile(np.asarray(pose, dtype=float), (SCHEDULE_POINTS, 1))
    poses[:, index] = np.linspace(limit.lower, limit.upper, SCHEDULE_POINTS)
    return poses
