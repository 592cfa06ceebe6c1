"""Images of the bullet phantom with a known geometry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from hil.imaging import ConeBeam, Detector
from hil.imaging.phantoms import dodecahedron
from virtual_bus.xray.imaging import Optics, expected, exposed
from virtual_bus.xray.objects import STEEL_1_M, Ball, Item
from virtual_bus.xray.render import Panel, View

PHANTOM = dodecahedron()
DETECTOR = Detector(columns=640, rows=512, pitch_m=0.5e-3)
PANEL = Panel(columns=640, rows=512, pitch_m=0.5e-3)
ITEMS = [Ball(center, PHANTOM.radius_m, STEEL_1_M) for center in PHANTOM.centers_m]
RADIUS_PIXELS = PHANTOM.radius_m * 1.16 / 0.81 / 0.5e-3


def nominal(angles: np.ndarray) -> ConeBeam:
    """Geometry of a roll scan without any error."""
    rotation = Rotation.from_euler("y", np.reshape(angles, (-1, 1))).as_matrix()
    return ConeBeam.from_frames(rotation @ [0.0, 0.0, -0.81], rotation @ [0.0, 0.0, 0.35], rotation)


def image_of(beam: ConeBeam, optics: Optics | None = None, seed: int = 0, items: Sequence[Item] = ITEMS) -> np.ndarray:
    """One exposure (the first of `beam`)."""
    optics = optics or Optics()
    view = View(beam.source_in_phantom_m[0], beam.detector_in_phantom_m[0], beam.rotation[0])
    return exposed(expected([view], PANEL, items, optics, rays=2), optics, np.random.default_rng(seed))


@lru_cache
def scan(count: int = 24, seed: int = 3) -> tuple[ConeBeam, ConeBeam, tuple[np.ndarray, ...]]:
    """Nominal geometry, true geometry and images of a scan whose nine parameters are off by millimetres and milliradians."""
    rng = np.random.default_rng(seed)
    ideal = nominal(np.linspace(-1.5, 1.5, count))
    true = ideal.moved(rng.normal(0.0, np.repeat([1e-3, 3e-3, 5e-3], 3), (count, 9)))
    return ideal, true, tuple(image_of(true[k : k + 1], seed=seed + k) for k in range(count))
