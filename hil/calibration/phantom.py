"""Phantom calibration (thesis Sec. 2.2.2): the images of a scan of the bullet phantom become the geometry of each exposure."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from hil.calibration.bullets import find_bullets
from hil.calibration.phantom_pose import PoseFit, fit_poses, observe
from hil.errors import UnusableInput
from hil.imaging.geometry import ConeBeam
from hil.imaging.phantoms import BulletPhantom
from hil.imaging.scan_folder import ImageScan

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
    """Geometry of every exposure of a scan, referred to the phantom: `look_for_bullets`, then `fit_poses`. Raises as they do."""
    observed, sigma = look_for_bullets(scan, phantom, nominal, jobs, progress)
    return fit_poses(phantom.centers_m, observed, sigma, nominal, nine)


def look_for_bullets(
    scan: ImageScan,
    phantom: BulletPhantom,
    nominal: ConeBeam,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[np.ndarray, np.ndarray]:
    """Where every exposure shows the phantom's bullets.

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
    UnusableInput
        Unusable images.
    """
    if len(nominal) != len(scan):
        raise UnusableInput(f"{len(scan)} exposures, expected geometry of {len(nominal)}")
    depth = -nominal.source_m[:, 2]
    to_phantom = np.linalg.norm(nominal.source_m - nominal.phantom_m, axis=1)
    radius = phantom.radius_m * depth / to_phantom / scan.detector.pitch_m
    look = partial(_look, scan, phantom, nominal, radius)
    observed = np.full((len(scan), len(phantom.centers_m), 2), np.nan)
    sigma = np.full((len(scan), len(phantom.centers_m)), np.nan)
    if jobs > 1:
        with ProcessPoolExecutor(jobs) as pool:
            for done, (k, points, deviation) in enumerate(pool.map(look, range(len(scan)), chunksize=8)):
                observed[k], sigma[k] = points, deviation
                progress(done + 1, len(scan))
    else:
        for k in range(len(scan)):
            _, observed[k], sigma[k] = look(k)
            progress(k + 1, len(scan))
    return observed, sigma


def _look(scan: ImageScan, phantom: BulletPhantom, nominal: ConeBeam, radius: np.ndarray, k: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Observations of one exposure."""
    found = find_bullets(scan.frame(k), float(radius[k]))
    beam = nominal[k : k + 1]
    predicted = scan.detector.to_pixels(beam.project(phantom.centers_m)[0])
    distance = np.linalg.norm(predicted[:, None] - predicted[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    gate = GATE_SHARE * float(distance.min(axis=1).mean())
    points, deviation = observe(found.pixels, found.variance, phantom.centers_m, beam, scan.detector, float(radius[k]), gate)
    return k, points, deviation
