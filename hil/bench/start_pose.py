"""Position of a braked machine before homing: link encoders, less the windup of their gears."""

from __future__ import annotations

import numpy as np

from drivers.interface import Sample
from hil.machine import Machine
from virtual_bus.physics import Physics


def standing(machine: Machine, model: Physics, sample: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Return motor-side positions and gear windups of a braked machine before homing, (n_axes,) each [rad or m].

    A link encoder measures the joint behind its gear, and the load winds the gear up by an amount that follows from the machine file. Axes
    without a link encoder are assumed to stand at their motor side's position, which is zero at power-on.
    """
    link = sample.link_position
    pose = np.where(np.isfinite(link), link, np.nan_to_num(sample.position))
    windup = np.where(np.isfinite(link), _windup(machine, model, pose), 0.0)
    return pose - windup, windup


def _windup(machine: Machine, model: Physics, pose: np.ndarray) -> np.ndarray:
    """Return how far each link encoder is ahead of its motor side with the motor sides braked at `pose`, (n_axes,)."""
    model.place(pose)
    deflection = model.joint_positions
    tree = machine.plant.tree
    ahead = np.zeros(len(machine.axes))
    for encoder in machine.plant.encoders:
        kind, _, axis = encoder.channel.rpartition("position_")
        sign = 1.0 if kind == "link_" else -1.0
        ahead[machine.axis_index(axis)] += sign * sum(deflection[tree.joint_index(name)] for name in encoder.joints)
    return ahead
