"""What slow motion knows of effects with a state of their own: how late drives act, and inertia that hangs on springs."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.places import joint_at
from virtual_bus.effects.registry import module_of
from virtual_bus.effects.table import values_of
from virtual_bus.linear.left_out import linear_parts
from virtual_bus.settings import PlantSettings


def drives_late_s(settings: PlantSettings) -> np.ndarray:
    """Return how much later than its target each drive's current flows (axes,) [s]: its delay, and the mean delay of its lag.

    That is the integral of what the current lacks after a step of one, -(S^-1) of the error e' = S e.
    """
    axes = [drive.axis for drive in settings.drives]
    late_s = np.zeros(len(axes))
    for setting in linear_parts(settings.effects):
        module, values = module_of(setting.name), values_of(setting)
        if hasattr(module, "delay_s"):
            late_s[axes.index(setting.at)] += module.delay_s(*values)
        elif hasattr(module, "error_system") and (system := module.error_system(*values)).size:
            late_s[axes.index(setting.at)] -= np.linalg.inv(system)[0, 0]
    return late_s


def hanging_inertia(settings: PlantSettings) -> np.ndarray:
    """Return the inertia (axes,) [kg m^2 or kg] that memories of effects add to each axis's joint where motion is slow.

    With m' = R m + S a and the effort E m it is E R^-1 S: then m' is nothing and E m = -E R^-1 S a.
    """
    inertia = np.zeros(len(settings.drives))
    for setting in linear_parts(settings.effects):
        if hasattr(module_of(setting.name), "slopes"):
            slopes = module_of(setting.name).slopes(*values_of(setting))
            added = slopes.effort_of_memory @ np.linalg.solve(slopes.memory, slopes.motion[:, 2])
            inertia += added * np.array([drive.joint == joint_at(setting.at, settings) for drive in settings.drives])
    return inertia
