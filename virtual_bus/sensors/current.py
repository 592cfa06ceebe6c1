"""A drive's measurement of its own current (or effort): the acting current, white noise, and the converter's lattice."""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.sensors.encoder import quantised
from virtual_bus.settings import PlantSettings


@compiled
def current_reading(effort: float, noise: float, resolution: float) -> float:
    """Return the reading [drive's unit] of an effort with this sample's noise.

    A resolution of NaN says that there is no sensor; the reading is NaN then.
    """
    return quantised(effort + noise, resolution) if resolution >= 0.0 else np.nan


def current_arrays(settings: PlantSettings) -> tuple[np.ndarray, np.ndarray]:
    """Return resolution and noise rms (axes,) in the drives' units; NaN where an axis has no such sensor."""
    by_axis = {current.axis: current for current in settings.currents}
    found = [by_axis.get(drive.axis) for drive in settings.drives]
    return (
        np.array([current.resolution if current else np.nan for current in found]),
        np.array([current.noise_rms if current else np.nan for current in found]),
    )
