"""Overlay errors of a calibration: where a volume's points are drawn on a live image, and where they are (thesis Table 2.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

PLACES = {"centre": 0.0, "1/3": 1.0 / 3.0, "2/3": 2.0 / 3.0}
"""Share of the way from the image's middle to its border."""

AROUND = 8
"""Points a ring."""

STEP = 1e-6
"""Differences for the registration [m, rad]."""


@dataclass(frozen=True)
class Overlay:
    """Errors on the panel [m].

    Attributes
    ----------
    errors_m : (3, N) array
        Mean over the ring's points at each of `PLACES`, by pose.
    """

    errors_m: np.ndarray

    @property
    def table(self) -> dict[str, dict[str, float]]:
        """Return largest, largest of the best 90 %, and mean [m] over the poses, as in Table 2.3."""
        kept = max(1, int(np.floor(0.9 * self.errors_m.shape[1])))
        return {
            place: {"max": float(row.max()), "max_90": float(np.sort(row)[kept - 1]), "mean": float(row.mean())}
            for place, row in zip(PLACES, self.errors_m, strict=True)
        }


def overlay(true: ConeBeam, calibrated: ConeBeam, detector: Detector) -> Overlay:
    """Return how far from its true shadow a point is drawn.

    Points lie in the plane through the phantom's origin that is parallel to the panel, where the true geometry throws them on the image's
    middle and on rings of `PLACES` around it.

    Parameters
    ----------
    true, calibrated : ConeBeam
        Of the same N poses.
    detector : Detector
        For its size.
    """
    points = _points(true, detector)
    error = np.linalg.norm(calibrated.project(points) - true.project(points), axis=2)
    return Overlay(np.array([error[:, ring].mean(axis=1) for ring in _rings()]))


def registered(true: ConeBeam, calibrated: ConeBeam, detector: Detector) -> ConeBeam:
    """Return the calibrated geometry, its world shifted and turned as a whole to the least sum of squared overlay errors.

    A volume that was reconstructed with the same calibration stands in that world: an error common to all poses moves volume and overlay
    together and is not seen.
    """
    points = _points(true, detector)
    target = true.project(points)
    origin, turn = np.zeros(3), Rotation.identity()
    for _ in range(4):
        now = calibrated.referred_to(origin, turn.as_matrix())
        left = target - now.project(points)
        columns = []
        for k in range(6):
            step = np.zeros(6)
            step[k] = STEP
            moved = now.referred_to(step[:3], Rotation.from_rotvec(step[3:]).as_matrix())
            columns.append(((moved.project(points) - now.project(points)) / STEP).ravel())
        change = np.linalg.lstsq(np.column_stack(columns), left.ravel(), rcond=None)[0]
        origin = origin + turn.apply(change[:3])
        turn = turn * Rotation.from_rotvec(change[3:])
    return calibrated.referred_to(origin, turn.as_matrix())


def _rings() -> list[slice]:
    return [slice(0, 1), slice(1, 1 + AROUND), slice(1 + AROUND, 1 + 2 * AROUND)]


def _points(true: ConeBeam, detector: Detector) -> np.ndarray:
    """Return points (N, 17, 3) in the phantom's frame, the middle's first."""
    half = 0.5 * detector.pitch_m * np.array([detector.columns, detector.rows * detector.aspect])
    angles = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * half
    on_panel = np.vstack([np.zeros((1, 2)), *(share * ring for share in list(PLACES.values())[1:])])
    on_panel = np.column_stack([on_panel, np.zeros(len(on_panel))])
    share = (true.source_m[:, 2] - true.phantom_m[:, 2]) / true.source_m[:, 2]
    seen = true.source_m[:, None] + share[:, None, None] * (on_panel[None] - true.source_m[:, None])
    errors: np.ndarray = np.einsum("nij,npj->npi", true.rotation, seen - true.phantom_m[:, None])
    return errors
