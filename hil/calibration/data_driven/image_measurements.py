"""Images as measurements of the data-driven filter."""

from __future__ import annotations

import numpy as np

from hil.calibration.data_driven.observed_beam import ObservedBeam
from hil.calibration.data_driven.values import SPOT_M, Measurement
from hil.calibration.marker.scan import MarkerScan
from hil.calibration.phantom.pose import PoseFit
from hil.imaging.nominal import nominal_beam
from hil.imaging.scan_folder import ImageScan
from hil.machine import Machine


def from_phantom(machine: Machine, scan: ImageScan, fit: PoseFit, observed: ObservedBeam) -> list[Measurement]:
    """Return the usable exposures of the phantom, all nine parameters of each."""
    positions, _, _ = observed.at(scan.middle_s)
    deviation = fit.beam.deviation_from(nominal_beam(machine, positions))
    wobble = np.diag(np.repeat([SPOT_M**2, 0.0], [3, 6]))
    return [Measurement(float(scan.middle_s[k]), deviation[k], fit.covariance[k] + wobble) for k in np.flatnonzero(fit.good)]


def from_marker(scan: ImageScan, found: MarkerScan) -> list[Measurement]:
    """Return the usable exposures of the marker plate."""
    change = (found.values - found.nominal)[:, :6]
    return [Measurement(float(scan.middle_s[k]), change[k], found.covariance[k][:6, :6], "marker") for k in np.flatnonzero(found.good)]
