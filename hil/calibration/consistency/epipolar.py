"""Pairs of images, and the planes through both focal spots that both see.

Debbeler et al. 2013 and Aichert et al. 2015: the derivative of a plane's integral along its normal follows from either image, so that
their difference is noise where the geometry is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.calibration.consistency.plane_derivatives import PlaneDerivatives
from hil.calibration.consistency.seen_pixels import SeenPixels
from hil.imaging.geometry import ConeBeam

PLANES = 64
"""Planes of a pair."""
STEEPEST = 0.9
"""Of the sphere's radius over its centre's distance from the line between two focal spots: beyond, they face each other through it."""


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


def object_radius(images: Sequence[SeenPixels], beam: ConeBeam) -> float:
    """Return the radius [m] of the sphere about the isocentre that holds what images show."""
    depth = beam.phantom_m[:, 2] - beam.source_m[:, 2]
    share = depth / -beam.source_m[:, 2]
    foot = beam.source_m[:, :2] + (beam.phantom_m[:, :2] - beam.source_m[:, :2]) / share[:, None]
    return max(float(share[k] * np.hypot(*(image.at_m - foot[k]).T).max(initial=0.0)) for k, image in enumerate(images))


def pairs_of(beam: ConeBeam, radius_m: float) -> Pairs:
    """Return all pairs whose focal spots do not face each other through a sphere about the isocentre."""
    first, second = np.triu_indices(len(beam), 1)
    _, distance, _ = _baselines(beam[first], beam[second])
    chosen = radius_m < STEEPEST * distance
    return Pairs(first[chosen], second[chosen], radius_m)


@dataclass(frozen=True)
class Lines:
    """Where an image of each pair meets the pair's planes.

    Attributes
    ----------
    places : (3, P, K) array
        In the tables.
    factor : (P, K) array
        A table's value times this is the plane's derivative.
    """

    places: np.ndarray
    factor: np.ndarray


def lines_of(tables: PlaneDerivatives, pairs: Pairs, first: ConeBeam, second: ConeBeam) -> tuple[Lines, Lines]:
    """Return the lines of PLANES planes of every pair in either image, whose geometries are (P,) each."""
    baseline, distance, nearest = _baselines(first, second)
    toward = -nearest / distance[:, None]
    across = np.cross(baseline, toward)
    tilt = np.arcsin(np.minimum(pairs.radius_m / distance, STEEPEST))[:, None] * np.linspace(-1.0, 1.0, PLANES)
    normal = np.cos(tilt)[..., None] * across[:, None] - np.sin(tilt)[..., None] * toward[:, None]
    offset = -(normal @ first.source_in_phantom_m[..., None])[..., 0]
    return _lines(tables, pairs.first, first, normal, offset), _lines(tables, pairs.second, second, normal, offset)


def _baselines(first: ConeBeam, second: ConeBeam) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return directions (P, 3) from focal spot to focal spot, the isocentre's distances (P,), and the points (P, 3) nearest to it [m]."""
    start = first.source_in_phantom_m
    direction = second.source_in_phantom_m - start
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    nearest = start - np.sum(start * direction, axis=1)[:, None] * direction
    return direction, np.linalg.norm(nearest, axis=1), nearest


def _lines(tables: PlaneDerivatives, image: np.ndarray, beam: ConeBeam, normal: np.ndarray, offset: np.ndarray) -> Lines:
    """Return the lines of planes normal . x + offset = 0 through the focal spots."""
    own = normal @ beam.rotation
    offset = offset - (own @ beam.phantom_m[..., None])[..., 0]
    line = np.concatenate([own[..., :2], offset[..., None]], axis=-1)
    line /= np.hypot(line[..., 0], line[..., 1])[..., None]
    spot = beam.source_m
    distance = line[..., 0] * spot[:, :1] + line[..., 1] * spot[:, 1:2] + line[..., 2]
    places, sign = tables.places(image, line)
    return Lines(places, sign * (1.0 + (distance / spot[:, 2:]) ** 2))
