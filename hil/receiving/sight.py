"""Measurements from one frame during the run: the phantom's nine parameters or the marker plate's six."""

from __future__ import annotations

import numpy as np

from hil.calibration.data_driven.values import SPOT_M
from hil.calibration.marker.scan import SPOT_M as SPOT_ON_TUBE_M
from hil.calibration.marker.tube_to_panel import fit_marker
from hil.calibration.phantom.phantom_calibration import bullets_seen
from hil.calibration.phantom.pose import fit_poses
from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.markers import PLATES, MarkerPoints, MarkerProjection, find_marker
from hil.imaging.nominal import nominal_beam
from hil.imaging.phantoms import dodecahedron
from hil.machine import Machine

BRIGHT = 1000
"""Photons of a pixel in the image of the rehearsal."""


def phantom_in(image: np.ndarray, detector: Detector, machine: Machine, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return nine deviations (9,) from nominal at axis positions (axes,) by the bullet phantom, and their covariance (9, 9).

    None if the phantom is not seen.
    """
    phantom, nominal = dodecahedron(), nominal_beam(machine, positions)
    try:
        points, sigma = bullets_seen(image, detector, phantom, nominal)
        fit = fit_poses(phantom.centers_m, points[None], sigma[None], nominal, nine=True)
    except UnusableInputError:
        return None
    if not fit.good[0]:
        return None
    return fit.beam.deviation_from(nominal)[0], fit.covariance[0] + np.diag(np.repeat([SPOT_M**2, 0.0], [3, 6]))


SeenMarker = tuple[np.ndarray, np.ndarray, MarkerPoints]
"""Six parameters (6,) of (6.8), their covariance (6, 6), and the crossings."""


def marker_in(
    image: np.ndarray, detector: Detector, name: str, nominal: MarkerProjection, before: SeenMarker | None = None
) -> SeenMarker | None:
    """Return what the plate of this name shows, None if it is not seen; `before` is what it showed in the image before."""
    plate = PLATES[name]()
    try:
        found = find_marker(image, plate, nominal, detector, None if before is None else before[2])
        start = nominal if before is None else MarkerProjection(np.append(before[0], nominal.values[6:]))
        fit = fit_marker(found, plate, detector, start, spot_m=SPOT_ON_TUBE_M)
    except UnusableInputError:
        return None
    return fit.projection.values[:6], fit.covariance[:6, :6], found


def rehearse(detector: Detector, machine: Machine, plate: str | None, nominal: MarkerProjection | None) -> None:
    """Look at a drawn image of the plate of this name, without one of the phantom, so that all is compiled before the first frame comes."""
    image = np.full((detector.rows, detector.columns), BRIGHT, dtype=np.uint16)
    row, column = np.indices(image.shape)
    if plate is not None and nominal is not None:
        drawn = PLATES[plate]()
        groove = 0.5 * drawn.groove_m * nominal.values[2] / nominal.values[8] / detector.pitch_m
        for k, (first, last) in enumerate(detector.to_pixels(nominal.project(drawn.ends_m()))):
            across, along = (column, row) if k < len(drawn.x_m) else (row, column)
            one, other = (0, 1) if k < len(drawn.x_m) else (1, 0)
            image[(np.abs(across - first[one]) < groove) & (along > first[other]) & (along < last[other])] = 2 * BRIGHT
        marker_in(image, detector, plate, nominal, marker_in(image, detector, plate, nominal))
        return
    zero = np.zeros(len(machine.axes))
    phantom, beam = dodecahedron(), nominal_beam(machine, zero)
    radius = phantom.radius_m * -beam.source_m[0, 2] / np.linalg.norm(beam.source_m[0] - beam.phantom_m[0]) / detector.pitch_m
    for center in detector.to_pixels(beam.project(phantom.centers_m)[0]):
        image[np.hypot(column - center[0], row - center[1]) < radius] = BRIGHT // 4
    phantom_in(image, detector, machine, zero)
