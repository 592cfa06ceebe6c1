"""Where a marker plate's points fall on the panel (thesis 6.3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

PARAMETERS = ("focal_u", "focal_v", "focal_length", "theta_x", "theta_y", "theta_z", "offset_x", "offset_y", "plate_distance")
"""Of (6.8): f_x, f_y, Z-bar [m]; the angles [rad]; delta x^m, delta y^m, and the plate's distance from the focal spot [m]."""


@dataclass(frozen=True)
class MarkerProjection:
    """Projection (6.8) of a plate mounted in front of the tube.

    The plate's frame is parallel to the tube's; its origin lies at (offset_x, offset_y, plate_distance) from the focal spot. The tube is
    turned about the focal spot by theta against the detector. Panel coordinates are u and v of `hil.imaging.geometry`; pixel aspect and
    skew (6.4) belong to the detector.

    Attributes
    ----------
    values : (9,) array
        In the order of `PARAMETERS`.
    """

    values: np.ndarray

    @classmethod
    def nominal(cls, focal_length_m: float, plate_distance_m: float) -> MarkerProjection:
        """Return a projection with the focal spot above the panel's centre, the plate's centre below it, nothing turned."""
        return cls(np.array([0.0, 0.0, focal_length_m, 0.0, 0.0, 0.0, 0.0, 0.0, plate_distance_m]))

    @property
    def source_m(self) -> np.ndarray:
        """Focal spot (3,) in the detector's frame."""
        return np.array([self.values[0], self.values[1], -self.values[2]])

    @property
    def rotation(self) -> np.ndarray:
        """Rotation R(theta_x, theta_y, theta_z) of (6.6), (3, 3), extrinsic: from the tube's axes to the detector's."""
        matrix: np.ndarray = Rotation.from_euler("xyz", self.values[3:6]).as_matrix()
        return matrix

    @property
    def plate_m(self) -> np.ndarray:
        """Origin (3,) of the plate in the detector's frame."""
        shifted: np.ndarray = self.source_m + self.rotation @ self.values[6:]
        return shifted

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """Return panel coordinates [m] (..., 2) of points (..., 3) of the plate."""
        seen = (np.asarray(points_m) + self.values[6:]) @ self.rotation.T
        pixels: np.ndarray = self.values[:2] + self.values[2] * seen[..., :2] / seen[..., 2:]
        return pixels
