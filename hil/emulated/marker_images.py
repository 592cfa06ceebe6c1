"""Images of a marker plate as the emulated panel takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.imaging.detector import Detector
from hil.imaging.markers.plates import MarkerPlate
from hil.imaging.markers.projection import MarkerProjection
from virtual_bus.xray.imaging import Optics
from virtual_bus.xray.markers import Mounted, Plate, expected_with_plate
from virtual_bus.xray.motion import XraySide
from virtual_bus.xray.objects import STEEL_1_M, Item
from virtual_bus.xray.render import Panel, View


def steel(plate: MarkerPlate) -> Plate:
    """Return the plate in stainless steel."""
    half = 0.5 * plate.groove_m
    along_y = np.array([[x - half, x + half, *plate.y_reach_m] for x in plate.x_m])
    along_x = np.array([[*plate.x_reach_m, y - half, y + half] for y in plate.y_m])
    return Plate(plate.half_m, plate.opening_m, plate.thickness_m, plate.depth_m, along_y, along_x, STEEL_1_M)


def expected_image(
    plate: MarkerPlate, projection: MarkerProjection, detector: Detector, optics: Optics, items: list[Item] | None = None
) -> np.ndarray:
    """Return expected photons (rows, columns); items are in the detector's frame."""
    view = View(projection.source_m, np.zeros(3), np.eye(3))
    panel = Panel(detector.columns, detector.rows, detector.pitch_m, detector.aspect, detector.skew)
    return expected_with_plate([view], panel, [Mounted(steel(plate), projection.plate_m, projection.rotation)], optics, items or ())


@dataclass(frozen=True)
class TubeMarker:
    """A plate screwed to the emulated tube.

    Attributes
    ----------
    plate : MarkerPlate
    distance_m : float
        Distance from the cold focal spot.
    rotation : (3, 3) array
        The plate's axes in the tube's frame (`hil.imaging.nominal.panel_in_tube`).
    """

    plate: MarkerPlate
    distance_m: float
    rotation: np.ndarray

    def expected(
        self, side: XraySide, start_s: float, width_s: float, count: int, panel: Panel, items: list[Item], optics: Optics
    ) -> np.ndarray:
        """Return expected photons (rows, columns) of one exposure, the plate moving with the tube."""
        metal = steel(self.plate)
        position, rotation = side.tube(start_s + width_s * (np.arange(count) + 0.5) / count)
        held = side.source_m + self.distance_m * self.rotation[:, 2]
        mounted = [Mounted(metal, p + r @ held, r @ self.rotation) for p, r in zip(position, rotation, strict=True)]
        return expected_with_plate(side.views(start_s, width_s, count), panel, mounted, optics, items)
