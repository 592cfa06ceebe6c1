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
from hil.imaging.markers import PLATES, MarkerProjection, find_marker
from hil.imaging.nominal import nominal_beam
from hil.imaging.phantoms import dodecahedron
from hil.machine import Machine


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


def marker_in(image: np.ndarray, detector: Detector, name: str, nominal: MarkerProjection) -> tuple[np.ndarray, np.ndarray, int] | None:
    """Return six parameters (6,) of (6.8) by the plate of this name, their covariance (6, 6) and the crossings seen.

    None if the plate is not seen.
    """
    plate = PLATES[name]()
    try:
        found = find_marker(image, plate, nominal, detector)
        fit = fit_marker(found, plate, detector, nominal, spot_m=SPOT_ON_TUBE_M)
    except UnusableInputError:
        return None
    return fit.projection.values[:6], fit.covariance[:6, :6], len(found.index)
