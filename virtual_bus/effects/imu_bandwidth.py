"""IMU bandwidth: a low pass in the sensor."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.effect import IMU_CHANGE, Effect, Parameter
from virtual_bus.effects.residual import Residual, lag_of

EFFECT = Effect(
    name="imu_bandwidth",
    kind=IMU_CHANGE,
    parameters=(
        Parameter("fc", unit="Hz", low=0.0, high=1000.0, description="corner of the low pass; 0: as the machine file says, no effect"),
    ),
    equation="y = a / (1 + s / (2 pi fc))",
    convention="a first-order low pass of this corner on accelerometer and gyro, in place of the machine file's own",
    neighbours=("structural_mode", "clock_offset"),
    source="IEEE Std 1293, frequency response",
)


def _bandwidth(value: float, fc: float) -> float:
    return fc if fc > 0.0 else value


CHANGES = (("imu", "accelerometer_bandwidth", _bandwidth), ("imu", "gyro_bandwidth", _bandwidth))


def guess(residual: Residual) -> tuple[float]:
    """The corner that lags like the accelerometer's liveliest channel does."""
    channel = int(np.argmax(residual.simulated[:, :3].std(axis=0)))
    sample_s = residual.time_s[1] - residual.time_s[0]
    lag = max(lag_of(residual.measured[:, channel], residual.simulated[:, channel], sample_s), 1e-4)
    return (1.0 / (2.0 * np.pi * lag),)
