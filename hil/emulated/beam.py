"""Objects in the beam of an emulated machine, by the name of a scene or of a marker plate, and the image of an exposure."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.emulated.marker_images import TubeMarker
from hil.emulated.scenes import SCENES, scene
from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.marker_view import PLATE_M
from hil.imaging.markers import PLATES
from hil.imaging.nominal import panel_in_tube
from hil.machine import Machine
from virtual_bus.xray.imaging import Optics, expected, exposed
from virtual_bus.xray.motion import FocalSpot, XraySide
from virtual_bus.xray.objects import Item
from virtual_bus.xray.render import Panel

VIEWS = 4
"""Instants over which an exposure's pose is averaged."""

SPOT = FocalSpot(np.array([8e-6, 4e-6, 0.0]), 4.0, np.array([10e-6, 0.0, 0.0]), 48.3)
"""The emulated tube's focal spot: drifts by 8 and 4 um in 4 s as the anode warms, wobbles by 10 um as it turns (thesis Fig. 6.15)."""


@dataclass(frozen=True)
class Beam:
    """Objects about the isocentre, or a plate on the tube, and the blur of their images."""

    items: list[Item]
    marker: TubeMarker | None
    optics: Optics = field(default_factory=Optics)
    spot: FocalSpot = SPOT

    def image(self, side: XraySide, start_s: float, width_s: float, detector: Detector, rng: np.random.Generator) -> np.ndarray:
        """Return the counts (rows, columns) uint16 of one exposure."""
        panel = Panel(detector.columns, detector.rows, detector.pitch_m, detector.aspect, detector.skew)
        if self.marker is None:
            mean = expected(side.views(start_s, width_s, VIEWS), panel, self.items, self.optics)
        else:
            mean = self.marker.expected(side, start_s, width_s, VIEWS, panel, self.items, self.optics)
        return exposed(mean, self.optics, rng)


def beam_of(machine: Machine, name: str) -> Beam:
    """Return the beam of a name.

    Raises
    ------
    UnusableInputError
        The name is neither a scene nor a marker plate.
    """
    if name in PLATES:
        return Beam([], TubeMarker(PLATES[name](), PLATE_M, panel_in_tube(machine)))
    if name not in SCENES:
        raise UnusableInputError(f"scene {name}: there are {', '.join(SCENES)}, and marker plates {', '.join(PLATES)}")
    return Beam(scene(name), None)
