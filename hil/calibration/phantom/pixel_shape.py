"""Pixels that are not square: aspect and skew of (6.4), fitted with the nine parameters; together the eleven of a projection matrix."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

FEWEST = 9
"""Bullets an exposure needs: eighteen coordinates for eleven numbers."""

STEPS = 20
STEP = np.array([1e-6] * 9 + [1e-7] * 2)
"""Differences [m, rad, -]."""

AGREE = 5.0
"""Exposures whose aspect or skew is farther from the scan's than so many of its own standard deviations are not counted."""


@dataclass(frozen=True)
class PixelFit:
    """Geometry and pixels of N exposures, fitted to each by itself.

    Attributes
    ----------
    beam : ConeBeam
    aspect, skew : (N,) arrays
        As `Detector` has them; the thesis's 1 / eta and tau.
    covariance : (N, 11, 11) array
        Of the nine deviations, aspect and skew; NaN where an exposure shows too little.
    """

    beam: ConeBeam
    aspect: np.ndarray
    skew: np.ndarray
    covariance: np.ndarray

    def matrices(self, detector: Detector) -> np.ndarray:
        """Return the projection matrix (N, 3, 4) of each exposure with its own pixels."""
        own = [replace(detector, aspect=float(a), skew=float(s)) for a, s in zip(self.aspect, self.skew, strict=True)]
        return np.array([self.beam[k : k + 1].matrices(panel)[0] for k, panel in enumerate(own)])

    def of_the_panel(self, detector: Detector) -> tuple[Detector, np.ndarray]:
        """Return the panel with the weighted aspect and skew of all exposures, and their standard deviations (2,).

        Raises
        ------
        UnusableInputError
            No exposure could be used.
        """
        good = np.isfinite(self.covariance[:, 9, 9])
        if not good.any():
            raise UnusableInputError(f"no exposure shows {FEWEST} bullets; aspect and skew cannot be fitted")
        values, sigma = [], []
        for number, each in ((9, self.aspect), (10, self.skew)):
            deviation = np.sqrt(self.covariance[good, number, number])
            near = np.abs(each[good] - np.median(each[good])) < AGREE * deviation + 1e-12
            weight = near / deviation**2
            values.append(float(np.sum(weight * each[good]) / np.sum(weight)))
            sigma.append(float(1.0 / np.sqrt(np.sum(weight))))
        return replace(detector, aspect=values[0], skew=values[1]), np.array(sigma)


def fit_pixels(points_m: np.ndarray, pixels: np.ndarray, sigma: np.ndarray, start: ConeBeam, detector: Detector) -> PixelFit:
    """Fit eleven numbers per exposure by Gauss-Newton.

    Parameters
    ----------
    points_m : (P, 3) array
        Bullets in the phantom's frame.
    pixels : (N, P, 2) array
        Columns and rows where they are seen; NaN: not seen.
    sigma : (N, P) array
        Standard deviation of each coordinate [pixel].
    start : ConeBeam
        Of the N exposures.
    detector : Detector
        Its column pitch is taken as known, aspect and skew as a start.
    """
    count = len(start)
    present = np.isfinite(pixels).all(axis=2) & np.isfinite(sigma)
    good = present.sum(axis=1) >= FEWEST
    weight = np.where(present & good[:, None], 1.0 / np.where(present, sigma, 1.0), 0.0)
    beam, shape = start, np.tile([detector.aspect, detector.skew], (count, 1))
    for _ in range(STEPS):
        residual = np.nan_to_num(pixels - _project(beam, shape, points_m, detector)) * weight[..., None]
        jacobian = _jacobian(beam, shape, points_m, detector) * weight[..., None, None]
        normal = np.einsum("npia,npib->nab", jacobian, jacobian) + np.eye(11) * ~good[:, None, None]
        change = np.linalg.solve(normal, np.einsum("npia,npi->na", jacobian, residual)[..., None])[..., 0] * good[:, None]
        beam, shape = beam.moved(change[:, :9]), shape + change[:, 9:]
        if np.abs(change).max() < 1e-9:
            break
    covariance = np.linalg.inv(normal)
    covariance[~good] = np.nan
    return PixelFit(beam, shape[:, 0], shape[:, 1], covariance)


def _project(beam: ConeBeam, shape: np.ndarray, points_m: np.ndarray, detector: Detector) -> np.ndarray:
    """Return columns and rows (N, P, 2), every exposure with its own aspect and skew."""
    on_panel = beam.project(points_m) / detector.pitch_m
    row = on_panel[..., 1] / shape[:, :1]
    column = on_panel[..., 0] + shape[:, 1:] * row
    pixels: np.ndarray = np.stack([column, row], axis=-1) + detector.intrinsic[:2, 2]
    return pixels


def _jacobian(beam: ConeBeam, shape: np.ndarray, points_m: np.ndarray, detector: Detector) -> np.ndarray:
    """Return the Jacobian (N, P, 2, 11) by central differences."""
    result = np.empty((len(beam), len(points_m), 2, 11))
    for k, step in enumerate(STEP):
        change = np.zeros((len(beam), 11))
        change[:, k] = step
        ahead = _project(beam.moved(change[:, :9]), shape + change[:, 9:], points_m, detector)
        behind = _project(beam.moved(-change[:, :9]), shape - change[:, 9:], points_m, detector)
        result[..., k] = (ahead - behind) / (2.0 * step)
    return result
