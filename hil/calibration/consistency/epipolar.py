"""How far pairs of images contradict each other: planes through both focal spots, and what each image says of them.

Debbeler et al. 2013 and Aichert et al. 2015: the derivative of a plane's integral along its normal follows from either image, so that
their difference is noise where the geometry is right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.calibration.consistency.plane_derivatives import PlaneDerivatives
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

PLANES = 48
"""Planes of a pair."""
STEEPEST = 0.9
"""Of the sphere's radius over its centre's distance from the line between two focal spots: beyond, they face each other through it."""


def visible_radius(beam: ConeBeam, detector: Detector) -> float:
    """Return the radius [m] of the largest sphere about the isocentre whose shadow every image holds."""
    corner = detector.to_metres(np.array([detector.columns - 0.5, detector.rows - 0.5]))
    depth = beam.phantom_m[:, 2] - beam.source_m[:, 2]
    share = depth / -beam.source_m[:, 2]
    foot = beam.source_m[:, :2] + (beam.phantom_m[:, :2] - beam.source_m[:, :2]) / share[:, None]
    return float(((np.abs(corner) - np.abs(foot)).min(axis=1) * share).min())


@dataclass(frozen=True)
class Pairs:
    """Pairs of images, and the sphere about the isocentre that their planes meet.

    Attributes
    ----------
    first, second : (P,) arrays
        Numbers of the images.
    radius_m : float
    """

    first: np.ndarray
    second: np.ndarray
    radius_m: float


def pairs_of(beam: ConeBeam, radius_m: float) -> Pairs:
    """Return all pairs whose focal spots do not face each other through a sphere about the isocentre."""
    first, second = np.triu_indices(len(beam), 1)
    _, distance, _ = _baselines(beam[first], beam[second])
    chosen = radius_m < STEEPEST * distance
    return Pairs(first[chosen], second[chosen], radius_m)


def said(known: PlaneDerivatives, pairs: Pairs, first: ConeBeam, second: ConeBeam) -> tuple[np.ndarray, np.ndarray]:
    """Return what either image of a pair, in geometries (P,) each, says of the same planes: derivatives (P, PLANES) [m]."""
    baseline, distance, nearest = _baselines(first, second)
    toward = -nearest / distance[:, None]
    across = np.cross(baseline, toward)
    tilt = np.arcsin(np.minimum(pairs.radius_m / distance, STEEPEST))[:, None] * np.linspace(-1.0, 1.0, PLANES)
    normal = np.cos(tilt)[..., None] * across[:, None] - np.sin(tilt)[..., None] * toward[:, None]
    offset = -(normal @ first.source_in_phantom_m[..., None])[..., 0]
    return _derivatives(known, pairs.first, first, normal, offset), _derivatives(known, pairs.second, second, normal, offset)


def _baselines(first: ConeBeam, second: ConeBeam) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return directions (P, 3) from focal spot to focal spot, the isocentre's distances (P,), and the points (P, 3) nearest to it [m]."""
    start = first.source_in_phantom_m
    direction = second.source_in_phantom_m - start
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    nearest = start - np.sum(start * direction, axis=1)[:, None] * direction
    return direction, np.linalg.norm(nearest, axis=1), nearest


def _derivatives(known: PlaneDerivatives, image: np.ndarray, beam: ConeBeam, normal: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Return derivatives (P, K) of integrals over planes normal . x + offset = 0 through the focal spots, along their normals."""
    own = normal @ beam.rotation
    offset = offset - (own @ beam.phantom_m[..., None])[..., 0]
    line = np.concatenate([own[..., :2], offset[..., None]], axis=-1)
    line /= np.hypot(line[..., 0], line[..., 1])[..., None]
    spot = beam.source_m
    distance = line[..., 0] * spot[:, :1] + line[..., 1] * spot[:, 1:2] + line[..., 2]
    derivatives: np.ndarray = known.at(image, line) * (1.0 + (distance / spot[:, 2:]) ** 2)
    return derivatives
