"""Calibration phantoms as their drawings say: where the bullets are, in the phantom's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

GOLDEN = (1.0 + np.sqrt(5.0)) / 2.0


@dataclass(frozen=True)
class BulletPhantom:
    """Bullets in a frame of their own.

    Attributes
    ----------
    name : str
    centers_m : (n, 3) array
    radius_m : float
        Of every bullet.
    """

    name: str
    centers_m: np.ndarray
    radius_m: float

    @property
    def reach_m(self) -> float:
        """Distance of the farthest bullet from the origin."""
        return float(np.linalg.norm(self.centers_m, axis=1).max()) + self.radius_m


def dodecahedron(circumradius_m: float = 0.075, bullet_radius_m: float = 1.6e-3) -> BulletPhantom:
    """Return twenty corners of a dodecahedron, its centre, and two alignment bullets (thesis Sec. 2.2.2).

    The alignment bullets break its symmetry: they lie inside, on no symmetry axis, so that no rotation of the body takes all 23 bullets to
    themselves. The body is turned so that no two bullets hide each other over whole scans about the machine's axes.
    """
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
    long, short = GOLDEN, 1.0 / GOLDEN
    corners = [*signs]
    for i in (-1, 1):
        for j in (-1, 1):
            corners += [np.array([0.0, i * short, j * long]), np.array([i * short, j * long, 0.0]), np.array([j * long, 0.0, i * short])]
    body = np.array(corners) * circumradius_m / np.sqrt(3.0)
    inner = np.array([[0.0, 0.0, 0.0], [0.31, 0.17, -0.43], [-0.23, 0.47, 0.11]]) * circumradius_m
    centers = np.vstack([body, inner])
    turn = Rotation.from_euler("xyz", [0.31, 0.22, 0.47])
    return BulletPhantom("dodecahedron", turn.apply(centers), bullet_radius_m)
