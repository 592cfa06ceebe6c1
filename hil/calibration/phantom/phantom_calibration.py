"""Phantom calibration (thesis Sec. 2.2.2): the images of a scan of the bullet phantom become the geometry of each exposure."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from hil.calibration.phantom.bullets import find_bullets
from hil.calibration.phantom.pose import PoseFit, fit_poses, observe
from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.imaging.phantoms import BulletPhantom
from hil.imaging.scan_folder import ImageScan
from hil.processes.workers import end_with_the_parent

GATE_SHARE = 0.4
"""A shadow may lie this share of the mean distance between neighbouring bullets from where it is expected, after a common shift."""


def calibrate_phantom(
    scan: ImageScan,
    phantom: BulletPhantom,
    nominal: ConeBeam,
    nine: bool = True,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> PoseFit:
    """Calibrate every exposure of a scan, referred to the phantom: `look_for_bullets`, then `fit_poses`. Raises as they do."""
    observed, sigma = look_for_bullets(scan, phantom, nominal, jobs, progress)
    return fit_poses(phantom.centers_m, observed, sigma, nominal, nine)


def look_for_bullets(
    scan: ImageScan,
    phantom: BulletPhantom,
    nominal: ConeBeam,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[np.ndarray, np.ndarray]:
    """Find the phantom's bullets in every exposure.

    Parameters
    ----------
    scan : ImageScan
    phantom : BulletPhantom
    nominal : ConeBeam
        Expected geometry of the N exposures, the phantom near its origin.
    jobs : int
        Processes that look for bullets.
    progress : callable
        Told how many of how many images are done.

    Returns
    -------
    observed_m : (N, P, 2) array
        On the panel; NaN: not seen.
    sigma_m : (N, P) array

    Raises
    ------
    UnusableInputError
        Unusable images.
    """
    if len(nominal) != len(scan):
        raise UnusableInputError(f"{len(scan)} exposures, expected geometry of {len(nominal)}")
    look = partial(_look, scan, phantom, nominal)
    observed = np.full((len(scan), len(phantom.centers_m), 2), np.nan)
    sigma = np.full((len(scan), len(phantom.centers_m)), np.nan)
    if jobs > 1:
        with ProcessPoolExecutor(jobs, initializer=end_with_the_parent) as pool:
            for done, (k, points, deviation) in enumerate(pool.map(look, range(len(scan)), chunksize=8)):
                observed[k], sigma[k] = points, deviation
                progress(done + 1, len(scan))
    else:
        for k in range(len(scan)):
            _, observed[k], sigma[k] = look(k)
            progress(k + 1, len(scan))
    return observed, sigma


def _look(scan: ImageScan, phantom: BulletPhantom, nominal: ConeBeam, k: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the observations of one exposure."""
    return k, *bullets_seen(scan.frame(k), scan.detector, phantom, nominal[k : k + 1])


def bullets_seen(image: np.ndarray, detector: Detector, phantom: BulletPhantom, nominal: ConeBeam) -> tuple[np.ndarray, np.ndarray]:
    """Return bullets (P, 2) on the panel [m] and their deviations (P,) in one image; NaN: not seen.

    They are expected at a geometry of one exposure.

    Raises
    ------
    UnusableInputError
        Unusable image.
    """
    to_phantom = np.linalg.norm(nominal.source_m[0] - nominal.phantom_m[0])
    radius = float(phantom.radius_m * -nominal.source_m[0, 2] / to_phantom / detector.pitch_m)
    found = find_bullets(image, radius)
    predicted = detector.to_pixels(nominal.project(phantom.centers_m)[0])
    distance = np.linalg.norm(predicted[:, None] - predicted[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    gate = GATE_SHARE * float(distance.min(axis=1).mean())
    return observe(found.pixels, found.variance, phantom.centers_m, nominal, detector, radius, gate)
