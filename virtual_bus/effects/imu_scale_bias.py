"""IMU scale and bias: an inertial sensor with errors of scale and of zero."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.effect import CALIBRATION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each, one

EFFECT = Effect(
    name="imu_scale_bias",
    plain="The acceleration sensor reads a few per cent too much or too little, or something while at rest.",
    kind=CALIBRATION,
    parameters=(
        Parameter("sx", unit="", low=-0.2, high=0.2, description="relative scale error of the accelerometer's x"),
        Parameter("sy", unit="", low=-0.2, high=0.2, description="relative scale error of the accelerometer's y"),
        Parameter("sz", unit="", low=-0.2, high=0.2, description="relative scale error of the accelerometer's z"),
        Parameter("bx", unit="m/s^2", low=-5.0, high=5.0, description="bias of the accelerometer's x"),
        Parameter("by", unit="m/s^2", low=-5.0, high=5.0, description="bias of the accelerometer's y"),
        Parameter("bz", unit="m/s^2", low=-5.0, high=5.0, description="bias of the accelerometer's z"),
        Parameter("sg", unit="", low=-0.2, high=0.2, description="relative scale error of the gyro, all three alike"),
        Parameter("bg", unit="rad/s", low=-1.0, high=1.0, description="bias of the gyro, all three alike"),
    ),
    equation="y = (I + S) a + b",
    convention=(
        "reading = (1 + s) true + b per channel, in the sensor's frame, in addition to the machine file's bias; before noise and lattice"
    ),
    neighbours=("imu_misalignment",),
    source="IEEE Std 1293; IEEE Std 1431",
    family="imu",
    is_exact=True,
)


def calibration(sx: float, sy: float, sz: float, bx: float, by: float, bz: float, sg: float, bg: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the gain (2, 3, 3) of accelerometer and gyro, and the offset (6,) after it."""
    return np.stack([np.diag([1.0 + sx, 1.0 + sy, 1.0 + sz]), (1.0 + sg) * np.eye(3)]), np.array([bx, by, bz, bg, bg, bg])


def laws(place: Place) -> list[Law]:
    """Return one scale or bias, those of all three accelerometers, or all of them."""
    names = ("sx", "sy", "sz", "bx", "by", "bz", "sg", "bg")
    rest = dict.fromkeys(names, 0.0)
    singles = [one(name, 0.01, both_signs=True, **{other: 0.0 for other in rest if other != name}) for name in names]
    threes = [
        each(three, 0.01, both_signs=True, **{other: 0.0 for other in rest if other not in three}) for three in (names[:3], names[3:6])
    ]
    return [*singles, *threes, each(names, 0.01, both_signs=True)]
