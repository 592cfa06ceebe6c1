"""The nine geometric parameters (2.2) of every exposure, and the projection matrices they make.

Frames
------
d, detector: origin in the panel's centre; x = u along the columns' growing index, y = v along the rows' growing index, z = w normal to
the panel. The focal spot lies at negative z.
ph, phantom: whatever the geometry is referred to; the world's frame on the emulated machine, the phantom's own after a phantom calibration.

Parameters
----------
xi = [nu_s^d (3), nu_ph^d (3), theta_w (3)]: focal spot and phantom origin in the detector's frame [m], and the extrinsic x, y, z angles
[rad] of R_d^ph, the rotation from the detector's frame to the phantom's. So nu_s^ph = R_d^ph (nu_s^d - nu_ph^d).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hil.imaging.detector import Detector

NAMES = ("source_u", "source_v", "source_w", "phantom_u", "phantom_v", "phantom_w", "theta_x", "theta_y", "theta_z")
"""The nine parameters (2.2), in order: metres, metres, radians."""

DEVIATIONS = (*NAMES[:6], "rotation_u", "rotation_v", "rotation_w")
"""Deviations of the nine, as `ConeBeam.moved` takes them."""


@dataclass(frozen=True)
class ConeBeam:
    """Geometry of N exposures.

    Attributes
    ----------
    source_m : (N, 3) array
        Focal spot in the detector's frame.
    phantom_m : (N, 3) array
        Phantom origin in the detector's frame.
    rotation : (N, 3, 3) array
        R_d^ph: takes detector coordinates to phantom coordinates.
    """

    source_m: np.ndarray
    phantom_m: np.ndarray
    rotation: np.ndarray

    def __len__(self) -> int:
        """Return the number of exposures N."""
        return len(self.source_m)

    def __getitem__(self, index: slice | np.ndarray) -> ConeBeam:
        """Return some of the exposures."""
        return ConeBeam(self.source_m[index], self.phantom_m[index], self.rotation[index])

    @classmethod
    def from_parameters(cls, parameters: np.ndarray) -> ConeBeam:
        """Make a geometry from parameters (N, 9) in the order of `NAMES`."""
        values = np.atleast_2d(np.asarray(parameters, dtype=float))
        return cls(values[:, :3], values[:, 3:6], Rotation.from_euler("xyz", values[:, 6:]).as_matrix())

    @classmethod
    def from_frames(cls, source_m: np.ndarray, detector_m: np.ndarray, detector_rotation: np.ndarray) -> ConeBeam:
        """Make a geometry from focal spot (N, 3), panel centre (N, 3) and orientation (N, 3, 3), in the phantom's frame."""
        to_detector = np.swapaxes(detector_rotation, -1, -2)
        source = (to_detector @ (source_m - detector_m)[..., None])[..., 0]
        phantom = -(to_detector @ np.asarray(detector_m)[..., None])[..., 0]
        return cls(source, phantom, np.asarray(detector_rotation))

    @classmethod
    def from_matrices(cls, matrices: np.ndarray, detector: Detector) -> ConeBeam:
        """Make a geometry from matrices (N, 3, 4) of any scale and sign, as `matrices` makes them, for this detector's pixels.

        Raises
        ------
        ValueError
            A matrix is no projection: its left 3 x 3 block is singular or not finite.
        """
        metric = np.linalg.solve(detector.intrinsic, np.asarray(matrices, dtype=float))
        left = metric[..., :3]
        scale = np.linalg.norm(left[..., 2, :], axis=-1)
        singular = ~(np.abs(np.linalg.det(left)) > 1e-12 * scale**3)  # also where not finite
        if singular.any():
            raise ValueError(f"matrix {int(np.flatnonzero(np.atleast_1d(singular))[0])} is no projection: its left 3 x 3 block is singular")
        metric = metric * (np.sign(np.linalg.det(left)) / scale)[..., None, None]
        # With M = A R^T, A = [[f, 0, u0], [0, f, v0], [0, 0, 1]], f = -w of the source, (u0, v0) below it; a source in front of the panel.
        normal = metric[..., 2, :3]
        below = (metric[..., :2, :3] @ normal[..., None])[..., 0]
        rows = metric[..., :2, :3] - below[..., None] * normal[..., None, :]
        distance = np.linalg.norm(rows, axis=-1).mean(axis=-1)
        basis = np.concatenate([rows / distance[..., None, None], normal[..., None, :]], axis=-2)
        u, _, vt = np.linalg.svd(basis)
        to_detector = u @ vt
        source = np.concatenate([below, -distance[..., None]], axis=-1)
        upper = np.zeros((*distance.shape, 3, 3))
        upper[..., 0, 0] = upper[..., 1, 1] = distance
        upper[..., :2, 2] = below
        upper[..., 2, 2] = 1.0
        from_source = np.linalg.solve(upper, metric[..., 3:])[..., 0]  # phantom origin, seen from the focal spot
        return cls(source, source + from_source, np.swapaxes(to_detector, -1, -2))

    @property
    def parameters(self) -> np.ndarray:
        """Return the parameters (N, 9) in the order of `NAMES`."""
        angles = Rotation.from_matrix(self.rotation).as_euler("xyz")
        return np.concatenate([self.source_m, self.phantom_m, angles], axis=1)

    def moved(self, deviation: np.ndarray) -> ConeBeam:
        """Return the exposures with deviations (N, 9) added.

        A deviation is of source and phantom [m], and a rotation vector [rad] in the detector's frame. R_d^ph is multiplied by
        exp(deviation) from the right: unlike angles, rotation vectors have no pose in which they fail.
        """
        deviation = np.atleast_2d(deviation)
        turned = self.rotation @ Rotation.from_rotvec(deviation[:, 6:]).as_matrix()
        return ConeBeam(self.source_m + deviation[:, :3], self.phantom_m + deviation[:, 3:6], turned)

    def deviation_from(self, other: ConeBeam) -> np.ndarray:
        """Return the deviation (N, 9) with which `other.moved` gives this geometry: the thesis's Delta xi (2.3)."""
        turned = Rotation.from_matrix(np.swapaxes(other.rotation, 1, 2) @ self.rotation).as_rotvec()
        return np.concatenate([self.source_m - other.source_m, self.phantom_m - other.phantom_m, turned], axis=1)

    @property
    def source_in_phantom_m(self) -> np.ndarray:
        """Focal spot in the phantom's frame, (N, 3)."""
        source: np.ndarray = (self.rotation @ (self.source_m - self.phantom_m)[..., None])[..., 0]
        return source

    @property
    def detector_in_phantom_m(self) -> np.ndarray:
        """Panel centre in the phantom's frame, (N, 3)."""
        center: np.ndarray = -(self.rotation @ self.phantom_m[..., None])[..., 0]
        return center

    def referred_to(self, origin_m: np.ndarray, rotation: np.ndarray) -> ConeBeam:
        """Return the same exposures in another frame, given by origin (3,) and orientation (3, 3) in the present one."""
        to_new = np.asarray(rotation).T
        return ConeBeam(
            self.source_m,
            self.phantom_m + (np.swapaxes(self.rotation, -1, -2) @ np.asarray(origin_m)),
            to_new @ self.rotation,
        )

    def matrices(self, detector: Detector) -> np.ndarray:
        """Return matrices (N, 3, 4) from homogeneous phantom coordinates [m] to homogeneous (column, row, 1).

        Their scale is the depth from the focal spot [m].
        """
        depth = -self.source_m[:, 2]
        upper = np.zeros((len(self), 3, 3))
        upper[:, 0, 0] = upper[:, 1, 1] = depth
        upper[:, 0, 2], upper[:, 1, 2], upper[:, 2, 2] = self.source_m[:, 0], self.source_m[:, 1], 1.0
        from_source = np.concatenate([np.swapaxes(self.rotation, 1, 2), (self.phantom_m - self.source_m)[..., None]], axis=2)
        projections: np.ndarray = detector.intrinsic @ upper @ from_source
        return projections

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """Return where points (P, 3) or (N, P, 3) of the phantom fall on the panel [m], (N, P, 2)."""
        points = np.asarray(points_m, dtype=float)
        seen = (points - self.detector_in_phantom_m[:, None, :]) @ self.rotation  # in the detector's frame
        source = self.source_m[:, None, :]
        share = source[..., 2] / (source[..., 2] - seen[..., 2])
        projected: np.ndarray = source[..., :2] + (seen[..., :2] - source[..., :2]) * share[..., None]
        return projected
