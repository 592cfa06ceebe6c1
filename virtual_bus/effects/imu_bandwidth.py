"""IMU bandwidth: a low pass in the sensor."""

from __future__ import annotations

from virtual_bus.effects.effect import IMU_CHANGE, Effect, Parameter
from virtual_bus.effects.law import Law, Place, fixed

EFFECT = Effect(
    name="imu_bandwidth",
    plain="The acceleration sensor smooths fast vibrations away that it should show.",
    kind=IMU_CHANGE,
    parameters=(
        Parameter(
            "fc", unit="Hz", low=0.0, high=10000.0, description="1 / (2 pi lag) of the low pass; 0: as the machine file says, no effect"
        ),
        Parameter(
            "shape",
            unit="",
            low=0.0,
            high=1.0,
            description="0: first order; 0.25: two equal ones in a row; 0.5: Butterworth's second order",
            is_strength=False,
            default=0.0,
        ),
    ),
    equation="y = a / (1 + s / wc + shape (s / wc)^2), wc = 2 pi fc",
    convention="a low pass of this lag on accelerometer and gyro, in place of the machine file's own of first order",
    neighbours=("structural_mode", "clock_offset"),
    source="IEEE Std 1293, frequency response: a proof mass on a spring, or filters in a row, are of second order",
    family="imu",
    is_exact=True,
)


def _bandwidth(value: float, fc: float, shape: float) -> float:
    return fc if fc > 0.0 else value


def _shape(value: float, fc: float, shape: float) -> float:
    return shape if fc > 0.0 else value


CHANGES = (("imu", "accelerometer_bandwidth", _bandwidth), ("imu", "gyro_bandwidth", _bandwidth), ("imu", "low_pass_shape", _shape))


def laws(place: Place) -> list[Law]:
    """Return low passes over the band, of first and second order."""
    return [fixed(fc=share / place.period_s, shape=shape) for share in (0.03, 0.06, 0.12, 0.25, 0.5) for shape in (0.0, 0.5)]
