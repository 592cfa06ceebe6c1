"""Circular scans of ASTRA and LEAP in their own few numbers, as vectors [mm]: source, panel centre, steps to the next column and row.

ASTRA's "cone" (its documentation of 3D geometries): angles about z, source at (sin, -cos, 0) DistanceOriginSource, panel at the other
side, columns along (cos, sin, 0), rows along z. LEAP's `set_conebeam` (its technical manual, cone beam): source at sod t - tau p with
t = (cos, sin, 0) and p = (-sin, cos, 0) of the angle phis - 90 degrees, panel sdd along -t from there, column i at
pixelWidth (i - centerCol) along p, row j at pixelHeight (j - centerRow) along z.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

ASTRA_CONE = ("projectionangles", "distanceoriginsource", "distanceorigindetector", "detectorspacingx", "detectorspacingy")
LEAP_CONE = ("phis", "sod", "sdd", "pixelheight", "pixelwidth", "centerrow", "centercol", "numrows", "numcols")
_NOT_IN_A_CIRCLE = ("helicalPitch", "tiltAngle", "pitchAngle")


def astra_circle(found: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return source, centre, u, v (N, 3) [mm] of ASTRA's cone; `found` has lower-case names."""
    angles = np.atleast_1d(np.asarray(found["projectionangles"], dtype=np.float64))
    to_source, to_panel, across, along = (float(np.asarray(found[name])) for name in ASTRA_CONE[1:])
    out = np.column_stack([np.sin(angles), -np.cos(angles), 0.0 * angles])
    columns = np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    return to_source * out, -to_panel * out, across * columns, np.tile([0.0, 0.0, along], (len(angles), 1))


def leap_circle(found: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return source, centre, u, v (N, 3) [mm] of LEAP's cone beam; ValueError where it is no circle."""
    for name in _NOT_IN_A_CIRCLE:
        if np.any(found.get(name.lower(), 0.0)):
            raise ValueError(f"{name} is not 0: no circle; LEAP's convert_to_modularbeam gives vectors, which are read")
    angles = np.radians(np.atleast_1d(np.asarray(found["phis"], dtype=np.float64)) - 90.0)
    numbers = (float(np.asarray(found[name])) for name in LEAP_CONE[1:])
    sod, sdd, height, width, row, column, rows, columns = numbers
    outwards = np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    across = np.column_stack([-np.sin(angles), np.cos(angles), 0.0 * angles])
    source = sod * outwards - float(np.asarray(found.get("tau", 0.0))) * across
    center = source - sdd * outwards + width * (0.5 * (columns - 1.0) - column) * across
    center[:, 2] += height * (0.5 * (rows - 1.0) - row)
    return source, center, width * across, np.tile([0.0, 0.0, height], (len(angles), 1))
