"""Which marker plate a receiver looks for, and where it should be."""

from __future__ import annotations

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.markers import PLATES, MarkerPlate, MarkerProjection
from hil.imaging.nominal import nominal_beam
from hil.machine import Machine

PLATE_M = 0.25
"""Distance of a marker plate from the focal spot."""


def plate_of(name: str) -> MarkerPlate:
    """Return the plate of this name; UnusableInputError where no plate has it."""
    if name not in PLATES:
        raise UnusableInputError(f"marker plate {name}: there are {', '.join(PLATES)}")
    return PLATES[name]()


def plate_at_m(distance_mm: object) -> float:
    """Return a plate's distance in metres; UnusableInputError where it is none."""
    if not isinstance(distance_mm, (int, float)) or not 0.0 < distance_mm < np.inf:
        raise UnusableInputError(f"distance of the marker plate {distance_mm} mm: must be a positive number")
    return 1e-3 * float(distance_mm)


def watched_marker(machine: Machine, name: str) -> tuple[MarkerPlate | None, MarkerProjection | None]:
    """Return the plate of this name and its nominal view; None for both where no plate has this name."""
    if name not in PLATES:
        return None, None
    u, v, w = nominal_beam(machine, np.zeros((1, len(machine.axes)))).source_m[0]
    return PLATES[name](), MarkerProjection(np.array([u, v, -w, 0.0, 0.0, 0.0, 0.0, 0.0, PLATE_M]))
