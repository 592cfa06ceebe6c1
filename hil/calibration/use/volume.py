"""The reconstruction volume (2.1): the points that every exposure sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from hil.errors import BadAnswerError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam


@dataclass(frozen=True)
class ReconstructionVolume:
    """The intersection of N exposure volumes, a convex body.

    Attributes
    ----------
    corners_m : (c, 3) array
        In the phantom's frame.
    volume_m3 : float
    radius_m : float
        Of the largest ball about the phantom's origin that every exposure sees; 0 where the origin is not seen by all.
    """

    corners_m: np.ndarray
    volume_m3: float
    radius_m: float


def reconstruction_volume(beam: ConeBeam, detector: Detector) -> ReconstructionVolume:
    """Intersect the exposures' pyramids from focal spot to panel (Definitions 2.1, 2.2), exactly: by their faces.

    Raises
    ------
    BadAnswerError
        No point is seen by all exposures.
    """
    faces = _faces(beam, detector)
    inside = _deepest(faces)
    if inside is None:
        raise BadAnswerError("no point is seen by all exposures; their volumes do not overlap")
    try:
        corners = HalfspaceIntersection(faces, inside).intersections
        hull = ConvexHull(corners)
    except QhullError as error:
        raise BadAnswerError(f"the reconstruction volume has no extent: {str(error).splitlines()[0]}") from None
    return ReconstructionVolume(corners[hull.vertices], float(hull.volume), max(0.0, float(-faces[:, 3].max())))


def _faces(beam: ConeBeam, detector: Detector) -> np.ndarray:
    """Return outward unit normals and offsets (5 N, 4), n x + b <= 0 inside: four sides of each pyramid, and the panel."""
    half = 0.5 * detector.pitch_m * np.array([detector.columns, detector.rows * detector.aspect])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    corners_m = np.column_stack([corners, np.zeros(4)])
    faces = []
    for k in range(len(beam)):
        source = beam.source_m[k]
        for a, b in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
            normal = np.cross(a - source, b - source)
            normal /= np.linalg.norm(normal)
            if normal @ (corners_m.mean(axis=0) - source) > 0.0:
                normal = -normal
            faces.append(_in_phantom(beam, k, normal, source))
        faces.append(_in_phantom(beam, k, np.array([0.0, 0.0, 1.0]), np.zeros(3)))
    return np.array(faces)


def _in_phantom(beam: ConeBeam, k: int, normal: np.ndarray, point: np.ndarray) -> np.ndarray:
    turned = beam.rotation[k] @ normal
    return np.array([*turned, -normal @ (point - beam.phantom_m[k])])


def _deepest(faces: np.ndarray) -> np.ndarray | None:
    """Return the middle (3,) of the largest ball inside all faces; None where there is none."""
    from scipy.optimize import linprog

    found = linprog([0, 0, 0, -1], A_ub=np.column_stack([faces[:, :3], np.ones(len(faces))]), b_ub=-faces[:, 3], bounds=[(None, None)] * 4)
    return found.x[:3] if found.status == 0 and found.x[3] > 0.0 else None
