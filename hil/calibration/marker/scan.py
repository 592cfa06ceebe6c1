"""The geometry of every exposure of a scan from the marker plate on its tube."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hil.calibration.marker.image_quality import ImageQuality, quality_of
from hil.calibration.marker.tube_to_panel import LINEAR, NONLINEAR, MarkerFit, fit_marker, fit_marker_linear
from hil.errors import UnusableInputError
from hil.files.arrays import write_arrays
from hil.imaging.geometry import ConeBeam
from hil.imaging.markers import MarkerPlate, MarkerPoints, MarkerProjection, find_marker
from hil.imaging.markers.projection import PARAMETERS
from hil.imaging.scan_folder import ImageScan
from hil.processes.workers import end_with_the_parent

FORMAT = 1

SPOT_M = 13e-6
"""Motion of a focal spot on its tube, the anode's wobble and heat together (thesis Fig. 6.15)."""


@dataclass(frozen=True)
class MarkerScan:
    """Parameters (6.8) of N exposures; rows of exposures that could not be used are NaN.

    Attributes
    ----------
    free : tuple of str
        The parameters fitted, of `PARAMETERS`.
    values, nominal : (N, 9) arrays
        [m, rad]
    covariance : (N, 9, 9) array
    points, refused : (N,) int arrays
        Crossings used; lines that were not.
    residual_pixels : (N,) array
    unusable : dict
        Exposure number to reason.
    quality : ImageQuality
    """

    free: tuple[str, ...]
    values: np.ndarray
    nominal: np.ndarray
    covariance: np.ndarray
    points: np.ndarray
    refused: np.ndarray
    residual_pixels: np.ndarray
    unusable: dict[int, str]
    quality: ImageQuality

    @property
    def good(self) -> np.ndarray:
        """Which exposures could be used, (N,) bool."""
        complete: np.ndarray = np.isfinite(self.values).all(axis=1)
        return complete


def nominal_marker(beam: ConeBeam, distance_m: float) -> list[MarkerProjection]:
    """Return where a plate should be seen, exposure by exposure.

    The plate stands `distance_m` from the focal spot and parallel to the panel.
    """
    return [MarkerProjection(np.array([u, v, -w, 0.0, 0.0, 0.0, 0.0, 0.0, distance_m])) for u, v, w in beam.source_m]


def calibrate_marker(
    scan: ImageScan,
    plate: MarkerPlate,
    nominal: Sequence[MarkerProjection],
    free: Sequence[str] = NONLINEAR,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> MarkerScan:
    """Find the plate in every image and fit its pose: by linear least squares where `LINEAR` is what is free, else by Gauss-Newton.

    Raises
    ------
    UnusableInputError
        No image shows the plate, or the parameters cannot be told apart.
    """
    look = partial(_look, scan, plate, list(nominal), tuple(free))
    count = len(scan)
    values, covariance = np.full((count, 9), np.nan), np.full((count, 9, 9), np.nan)
    points, refused, residual = np.zeros(count, dtype=int), np.zeros(count, dtype=int), np.full(count, np.nan)
    quality = np.full((count, 3), np.nan)
    unusable: dict[int, str] = {}

    def take(results: Iterable[tuple[MarkerFit, MarkerPoints] | str]) -> None:
        for k, result in enumerate(results):
            if isinstance(result, str):
                unusable[k] = result
            else:
                fit, found = result
                values[k], covariance[k], residual[k] = fit.projection.values, fit.covariance, fit.residual_pixels
                points[k], refused[k], quality[k] = len(found.index), len(found.refused), quality_of(found, plate)
            progress(k + 1, count)

    if jobs > 1:
        with ProcessPoolExecutor(jobs, initializer=end_with_the_parent) as pool:
            take(pool.map(look, range(count), chunksize=8))
    else:
        take(map(look, range(count)))
    if len(unusable) == count:
        raise UnusableInputError(f"{scan.folder}: no image of {count} could be used; the first: {unusable[0]}")
    names = tuple(name for name in PARAMETERS if name in free)
    nominal_values = np.array([each.values for each in nominal])
    seen = ImageQuality(quality[:, 0], quality[:, 1:])
    return MarkerScan(names, values, nominal_values, covariance, points, refused, residual, unusable, seen)


def _look(
    scan: ImageScan, plate: MarkerPlate, nominal: list[MarkerProjection], free: tuple[str, ...], k: int
) -> tuple[MarkerFit, MarkerPoints] | str:
    """Return fit and crossings of one image, or why there are none."""
    image = scan.frame(k)
    try:
        found = find_marker(image, plate, nominal[k], scan.detector)
        if set(free) == set(LINEAR):
            return fit_marker_linear(found, plate, scan.detector, nominal[k], SPOT_M), found
        return fit_marker(found, plate, scan.detector, nominal[k], free, SPOT_M), found
    except UnusableInputError as error:
        return str(error)


def write_marker_scan(result: MarkerScan, scan: ImageScan, notes: dict[str, object], path: Path) -> None:
    """Write the scan to its file; raise RecordingError where it cannot be written."""
    arrays = {
        "format": FORMAT,
        "parameters": PARAMETERS,
        "free": result.free,
        "exposure_id": scan.exposure_id,
        "time_s": scan.middle_s,
        "axes": scan.axes,
        "positions": scan.positions,
        "values": result.values,
        "nominal": result.nominal,
        "covariance": result.covariance,
        "points": result.points,
        "deviation_pixels": result.quality.deviation_pixels,
        "blur_pixels": result.quality.blur_pixels,
        "notes": json.dumps(notes),
    }
    write_arrays(path, arrays)
