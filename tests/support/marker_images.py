"""Images of marker plates with a known geometry; 1.2 pixels of blur, all of it the panel's."""

from __future__ import annotations

from functools import cache

import numpy as np

from hil.emulated.marker_images import expected_image
from hil.imaging import Detector
from hil.imaging.markers import PLATES, MarkerProjection
from virtual_bus.xray.imaging import Optics, exposed

DETECTOR = Detector(columns=640, rows=512, pitch_m=0.5e-3)
NOMINAL = MarkerProjection.nominal(1.16, 0.25)
TRUE = MarkerProjection(NOMINAL.values + np.array([1e-3, -2e-3, 2e-3, 4e-3, -3e-3, 6e-3, 0.0, 0.0, 0.0]))


def optics(photons: float) -> Optics:
    return Optics(photons=photons, spot_m=0.0, spread_m=1.2 * DETECTOR.pitch_m)


@cache
def mean_image(plate: str, photons: float) -> np.ndarray:
    return expected_image(PLATES[plate](), TRUE, DETECTOR, optics(photons))


def image(plate: str, photons: float, seed: int) -> np.ndarray:
    return exposed(mean_image(plate, photons), optics(photons), np.random.default_rng(seed))


def truth(plate: str) -> np.ndarray:
    return DETECTOR.to_pixels(TRUE.project(PLATES[plate]().points_m))
