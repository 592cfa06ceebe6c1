"""IMU misalignment: a sensor turned against the frame the machine file gives it."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from virtual_bus.effects.effect import CALIBRATION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each, one

EFFECT = Effect(
    name="imu_misalignment",
    plain="The acceleration sensor is mounted at an angle, so that each of its axes reads a bit of the others.",
    kind=CALIBRATION,
    parameters=(
        Parameter("rx", unit="phase", low=-0.5, high=0.5, description="rotation vector's x component, in the sensor's frame"),
        Parameter("ry", unit="phase", low=-0.5, high=0.5, description="rotation vector's y component, in the sensor's frame"),
        Parameter("rz", unit="phase", low=-0.5, high=0.5, description="rotation vector's z component, in the sensor's frame"),
    ),
    equation="y = R a, R of the rotation vector (rx, ry, rz)",
    convention=(
        "reading = R(r) times the true vector in the nominal sensor frame, accelerometer and gyro alike: the reading is what "
        "the nominal sensor would read of a world turned by +r; before bias, noise and lattice"
    ),
    neighbours=("axis_coupling", "imu_scale_bias"),
    source="IEEE Std 1293; IEEE Std 1431",
    family="imu",
    is_exact=True,
)


def calibration(rx: float, ry: float, rz: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the gain (2, 3, 3) of accelerometer and gyro, and a zero offset (6,)."""
    turned = Rotation.from_rotvec([rx, ry, rz]).as_matrix() if (rx, ry, rz) != (0.0, 0.0, 0.0) else np.eye(3)
    return np.stack([turned, turned]), np.zeros(6)


def laws(place: Place) -> list[Law]:
    """Return a small turn about one axis, or any."""
    names = ("rx", "ry", "rz")
    singles = [one(name, 0.01, both_signs=True, **{other: 0.0 for other in names if other != name}) for name in names]
    return [*singles, each(names, 0.01, both_signs=True)]
