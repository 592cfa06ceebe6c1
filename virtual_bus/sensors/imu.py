"""Inertial units after their low passes (which run with the plant): bias, white noise, resolution."""

from __future__ import annotations

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.sensors.encoder import quantised
from virtual_bus.settings import PlantSettings


@compiled
def measured_channel(value: float, bias: float, noise: float, resolution: float) -> float:
    """Return the reading [m/s² or rad/s] of one channel with this sample's noise."""
    return quantised(value + bias + noise, resolution)


def imu_arrays(settings: PlantSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return bias, noise rms and resolution (6 imus,): specific force x, y, z, then angular rate x, y, z."""

    def stacked(parts: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(parts) if parts else np.zeros(0)

    imus = settings.imus
    return (
        stacked([np.concatenate([imu.accelerometer_bias_m_s2, imu.gyro_bias_rad_s]) for imu in imus]),
        stacked([np.concatenate([imu.accelerometer_noise_rms_m_s2, imu.gyro_noise_rms_rad_s]) for imu in imus]),
        stacked([np.repeat([imu.accelerometer_resolution_m_s2, imu.gyro_resolution_rad_s], 3) for imu in imus]),
    )
