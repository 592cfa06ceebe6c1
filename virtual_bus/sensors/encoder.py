"""Encoders and speed sensors: the sum of one or more joints, on a lattice that is fixed to the scale."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.settings import Encoder, PlantSettings, SpeedSensor


@compiled
def quantised(value: float, resolution: float) -> float:
    """Return the nearest multiple of `resolution`, halves upwards: resolution * floor(value / resolution + 1/2).

    A resolution of 0 is no lattice.
    """
    return value if resolution <= 0.0 else resolution * math.floor(value / resolution + 0.5)


@compiled
def encoder_reading(position: float, resolution: float) -> float:
    """Return what an encoder reads of a position, or a speed sensor of a speed.

    A resolution of NaN says that there is no sensor; the reading is NaN then.
    """
    return quantised(position, resolution) if resolution >= 0.0 else np.nan


@compiled
def summed_speed(weights: np.ndarray, state: np.ndarray) -> float:
    """Return the speed [rad/s or m/s] seen by a sensor whose joints have weight 1.

    `state` is a plant's: joint positions, then joint speeds.
    """
    total = 0.0
    for j in range(len(weights)):
        total += weights[j] * state[len(weights) + j]
    return total


@compiled
def summed_position(weights: np.ndarray, joint_positions: np.ndarray) -> float:
    """Return the position [rad or m] seen by an encoder whose joints have weight 1 and all others 0."""
    total = 0.0
    for j in range(len(weights)):
        total += weights[j] * joint_positions[j]
    return total


def encoder_arrays(settings: PlantSettings, prefix: str) -> tuple[np.ndarray, np.ndarray]:
    """Return joint weights (axes, n) and resolutions (axes,) of the sensors `<prefix>_<axis>`.

    The resolution is NaN where an axis has none.
    """
    chosen: dict[str, Encoder | SpeedSensor] = {sensor.channel: sensor for sensor in settings.joint_sensors}
    encoders: Sequence[Encoder | SpeedSensor | None] = [chosen.get(f"{prefix}_{drive.axis}") for drive in settings.drives]
    weights = np.zeros((len(encoders), len(settings.tree.joints)))
    for row, encoder in zip(weights, encoders, strict=True):
        for joint in encoder.joints if encoder else ():
            row[settings.tree.joint_index(joint)] += 1.0
    return weights, np.array([encoder.resolution if encoder else np.nan for encoder in encoders])
