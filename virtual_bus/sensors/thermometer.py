"""Winding temperature: ambient plus a first-order response to the copper loss."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.settings import PlantSettings


@compiled
def warmed(rise: float, effort: float, rise_per_effort2: float, decay: float) -> float:
    """Return the temperature rise [K] one sample later, at constant effort [drive's unit].

    `decay` is exp(-sample period / time constant).
    """
    final = rise_per_effort2 * effort * effort
    return final + (rise - final) * decay


def thermometer_arrays(settings: PlantSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return ambient [degC], rise [K per squared effort], decay over a sample and resolution [K], each (axes,).

    The ambient is NaN where an axis has no thermometer.
    """
    by_axis = {thermometer.axis: thermometer for thermometer in settings.thermometers}
    found = [by_axis.get(drive.axis) for drive in settings.drives]
    return (
        np.array([t.ambient_degC if t else np.nan for t in found]),
        np.array([t.rise_K_per_unit2 if t else 0.0 for t in found]),
        np.array([math.exp(-settings.sample_period_s / t.time_constant_s) if t else 0.0 for t in found]),
        np.array([t.resolution_K if t else 0.0 for t in found]),
    )
