"""Motion of the focal spot on its tube, from a marker plate while the machine stands still (thesis Sec. 6.4.3, Fig. 6.15).

With the machine at rest only the spot moves the plate's shadow: by the plate's magnification m less one, in the opposite direction. So pose
and angles are fitted to all exposures together, and each exposure gives the plate's offset alone; an offset moves the shadow by m, so the
spot moved by m / (m - 1) of it. The anode rotates faster than the frame rate: it shows at its alias.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil.calibration.marker.scan import calibrate_marker, nominal_marker
from hil.errors import UnusableInputError
from hil.imaging.geometry import ConeBeam
from hil.imaging.markers import MarkerPlate, MarkerProjection
from hil.imaging.scan_folder import ImageScan

FEWEST = 16
"""Exposures for a spectrum."""

STOOD_RAD = 1e-3
"""Axis positions that differ by more are a motion, whose sag would be mistaken for the spot's."""

MEAN_OF = 8
"""Exposures averaged at either end for the drift."""


@dataclass(frozen=True)
class SpotTrack:
    """The focal spot against its mean, across the beam, along the panel's columns and rows.

    Attributes
    ----------
    time_s : (N,) array
    spot_m, sigma_m : (N, 2) arrays
    width_s : float
        Of an exposure.
    """

    time_s: np.ndarray
    spot_m: np.ndarray
    sigma_m: np.ndarray
    width_s: float

    @property
    def rate_Hz(self) -> float:
        """Mean rate of the exposures [Hz]."""
        return float(1.0 / np.median(np.diff(self.time_s)))

    @property
    def drift_m(self) -> np.ndarray:
        """Mean of the last exposures less mean of the first, (2,)."""
        drift: np.ndarray = self.spot_m[-MEAN_OF:].mean(axis=0) - self.spot_m[:MEAN_OF].mean(axis=0)
        return drift

    def spectrum(self) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies (M,) [Hz] to half the frame rate, and amplitudes (M, 2) [m], with drift removed as a parabola."""
        count = len(self.time_s)
        frequencies = np.arange(1, count // 2) * self.rate_Hz / count
        along = np.vander((self.time_s - self.time_s[0]) / np.ptp(self.time_s), 3)
        rest = self.spot_m - along @ np.linalg.lstsq(along, self.spot_m, rcond=None)[0]
        turned = np.exp(-2j * np.pi * frequencies[:, None] * self.time_s)
        return frequencies, 2.0 / count * np.abs(turned @ rest)

    def line(self, frequency_Hz: float) -> tuple[float, np.ndarray]:
        """Return where a line of the anode shows among these frames [Hz], and its amplitude (2,) [m] corrected for the exposure time."""
        alias = abs((frequency_Hz + 0.5 * self.rate_Hz) % self.rate_Hz - 0.5 * self.rate_Hz)
        turning = 2.0 * np.pi * frequency_Hz * self.time_s
        slow = np.vander((self.time_s - self.time_s[0]) / np.ptp(self.time_s), 3)
        design = np.column_stack([np.cos(turning), np.sin(turning), slow])
        cosine, sine = np.linalg.lstsq(design, self.spot_m, rcond=None)[0][:2]
        return float(alias), np.hypot(cosine, sine) / abs(np.sinc(frequency_Hz * self.width_s))


def spot_track(
    scan: ImageScan,
    plate: MarkerPlate,
    beam: ConeBeam,
    distance_m: float,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> SpotTrack:
    """Follow the spot through the exposures of a machine at rest.

    Raises
    ------
    UnusableInputError
        Too few exposures, or the machine moved.
    """
    if len(scan) < FEWEST:
        raise UnusableInputError(f"{scan.folder}: {len(scan)} exposures; a spectrum of the focal spot needs {FEWEST} at least")
    if np.nanmax(np.ptp(scan.positions, axis=0), initial=0.0) > STOOD_RAD:
        raise UnusableInputError(f"{scan.folder}: the axes moved during the exposures; the focal spot is followed on a machine at rest")
    count = len(scan)
    first = calibrate_marker(scan, plate, nominal_marker(beam, distance_m), jobs=jobs, progress=lambda done, _: progress(done, 2 * count))
    if first.unusable:
        number, reason = next(iter(first.unusable.items()))
        raise UnusableInputError(f"{scan.folder}: exposure {number} shows no plate: {reason}")
    held = MarkerProjection(np.median(first.values, axis=0))
    offsets = ("offset_x", "offset_y")
    found = calibrate_marker(scan, plate, [held] * count, offsets, jobs, lambda done, _: progress(count + done, 2 * count))
    magnification = held.values[2] / held.values[8]
    share = magnification / (magnification - 1.0)
    spot = -share * found.values[:, 6:8]
    sigma = share * np.sqrt(np.einsum("nii->ni", found.covariance)[:, 6:8])
    return SpotTrack(scan.middle_s, spot - spot.mean(axis=0), sigma, float(np.median(scan.width_s)))
