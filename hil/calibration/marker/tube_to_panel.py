"""Case I of thesis Sec. 6.4.1: the pose of tube and panel relative to each other, from a marker plate on the tube."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.markers import MarkerPlate, MarkerPoints, MarkerProjection
from hil.imaging.markers.projection import PARAMETERS

LINEAR = PARAMETERS[:3]
"""f_x, f_y and Z-bar: linear in the points once angles, offsets and the plate's distance are known."""

NONLINEAR = PARAMETERS[:6]
"""With the angles of (6.6)."""

OFFSETS = (6, 7)
"""offset_x and offset_y among `PARAMETERS`."""

UNSEEN_M, UNSEEN_RAD = 10e-3, 50e-3
"""A parameter with a larger standard deviation than this is not measured: more than the whole machine bends."""

STEPS = 30
SETTLED = 1e-10


@dataclass(frozen=True)
class MarkerFit:
    """Pose from one image.

    Attributes
    ----------
    projection : MarkerProjection
    free : tuple of str
        The parameters fitted, of `PARAMETERS`; the others kept the values they came with.
    covariance : (9, 9) array
        [m, rad]; zero where a parameter was held.
    residual_pixels : float
        Root mean square over all coordinates.
    """

    projection: MarkerProjection
    free: tuple[str, ...]
    covariance: np.ndarray
    residual_pixels: float

    @property
    def held(self) -> tuple[str, ...]:
        """The parameters that were not fitted."""
        return tuple(name for name in PARAMETERS if name not in self.free)


def fit_marker(
    points: MarkerPoints,
    plate: MarkerPlate,
    detector: Detector,
    start: MarkerProjection,
    free: Sequence[str] = NONLINEAR,
    spot_m: float = 0.0,
) -> MarkerFit:
    """Fit (6.8) to the crossings by Gauss-Newton.

    The plate is flat, so its image shows the ratio of `focal_length` to `plate_distance` and never both: one of them is held, by default
    the distance, which the mounting fixes. `offset_x` and `offset_y` are held by default too: on a plate parallel to the panel they
    cannot be told from `focal_u` and `focal_v`.

    Parameters
    ----------
    points : MarkerPoints
    plate : MarkerPlate
    detector : Detector
    start : MarkerProjection
        Where the fit starts, and the values of what is held.
    free : sequence of str
        Of `PARAMETERS`.
    spot_m : float
        How far the focal spot moves on the tube: by so much the plate's offsets are uncertain even where they are held.

    Raises
    ------
    UnusableInputError
        A name that is none, or parameters that this image cannot tell apart.
    """
    columns = _columns(free)
    seen, covariance = _metres(points, detector)
    weight = 1.0 / np.sqrt(np.diag(covariance))
    where = plate.points_m[points.index]
    values = start.values.copy()
    for _ in range(STEPS):
        rest = (seen - MarkerProjection(values).project(where).ravel()) * weight
        jacobian = _jacobian(values, where)[:, columns] * weight[:, None]
        scale = np.linalg.norm(jacobian, axis=0)
        change = np.linalg.lstsq(jacobian / scale, rest, rcond=1e-12)[0] / scale
        values[columns] += np.clip(change, -0.05, 0.05)
        if np.abs(change).max() < SETTLED:
            break
    return _result(values, columns, seen, covariance, weight, where, detector, spot_m)


def fit_marker_linear(
    points: MarkerPoints, plate: MarkerPlate, detector: Detector, known: MarkerProjection, spot_m: float = 0.0
) -> MarkerFit:
    """Fit f_x, f_y and Z-bar by linear least squares (Sec. 6.4.1).

    Angles, offsets and the plate's distance are as in `known`; nothing is iterated, and where the fit starts does not matter. The rest is
    as in `fit_marker`.
    """
    seen, covariance = _metres(points, detector)
    weight = 1.0 / np.sqrt(np.diag(covariance))
    where = plate.points_m[points.index]
    unit = known.values.copy()
    unit[:3] = 0.0, 0.0, 1.0
    matrix = np.zeros((len(seen), 3))
    matrix[0::2, 0] = matrix[1::2, 1] = 1.0
    matrix[:, 2] = MarkerProjection(unit).project(where).ravel()
    values = known.values.copy()
    values[:3] = np.linalg.lstsq(matrix * weight[:, None], seen * weight, rcond=None)[0]
    return _result(values, [0, 1, 2], seen, covariance, weight, where, detector, spot_m)


def _columns(free: Sequence[str]) -> list[int]:
    unknown = [name for name in free if name not in PARAMETERS]
    if unknown or not free:
        raise UnusableInputError(f"{', '.join(unknown) or 'nothing'} to fit: the parameters of a marker are {', '.join(PARAMETERS)}")
    if {"focal_length", "plate_distance"} <= set(free):
        raise UnusableInputError("focal_length and plate_distance: a flat plate shows their ratio alone; hold one of them")
    return [k for k, name in enumerate(PARAMETERS) if name in free]


def _metres(points: MarkerPoints, detector: Detector) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates (2n,) on the panel and their covariance."""
    to_metres, size = np.linalg.inv(detector.intrinsic[:2, :2]), 2 * len(points.index)

    def converted(rows: np.ndarray) -> np.ndarray:
        result: np.ndarray = np.einsum("ab,nbk->nak", to_metres, rows.reshape(-1, 2, size)).reshape(size, size)
        return result

    return detector.to_metres(points.pixels).ravel(), converted(converted(points.covariance).T).T


def _jacobian(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return the change (2n, 9) of the projected points (n, 3) with each parameter."""
    at = MarkerProjection(values)
    rotation, turn_z = at.rotation, values[5]
    seen = (where + values[6:]) @ rotation.T
    depth = seen[:, 2]
    by_point = np.zeros((len(where), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = values[2] / depth
    by_point[:, :, 2] = -values[2] * seen[:, :2] / depth[:, None] ** 2
    result = np.zeros((len(where), 2, 9))
    result[:, 0, 0] = result[:, 1, 1] = 1.0
    result[:, :, 2] = seen[:, :2] / depth[:, None]
    axes = (rotation[:, 0], np.array([-np.sin(turn_z), np.cos(turn_z), 0.0]), np.array([0.0, 0.0, 1.0]))
    for k, axis in enumerate(axes):  # about which the angle turns what is seen: extrinsic x first, z last
        x, y, z = axis
        across = seen @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # the axis' cross product with it
        result[:, :, 3 + k] = (by_point @ across[:, :, None])[:, :, 0]
    result[:, :, 6:] = by_point @ rotation
    return result.reshape(-1, 9)


def _result(
    values: np.ndarray,
    columns: list[int],
    seen: np.ndarray,
    covariance: np.ndarray,
    weight: np.ndarray,
    where: np.ndarray,
    detector: Detector,
    spot_m: float,
) -> MarkerFit:
    """Return the fit with the covariance of weighted least squares for correlated data.

    Points on one line share its errors, and all points share the error of the spot's place.
    """
    whole = _jacobian(values, where)
    jacobian = whole[:, columns]
    weighted = jacobian * weight[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    _, strength, combinations = np.linalg.svd(weighted / scale, full_matrices=False)
    gain = (np.linalg.pinv(weighted / scale, rcond=1e-14) / scale[:, None]) * weight
    by_spot = gain @ whole[:, [k for k in OFFSETS if k not in columns]] * spot_m
    of_free = gain @ covariance @ gain.T + by_spot @ by_spot.T
    limit = np.array([UNSEEN_RAD if 3 <= k < 6 else UNSEEN_M for k in columns])
    if strength[-1] < 1e-10 * strength[0] or (np.sqrt(np.diag(of_free)) > limit).any():
        strongest = np.argsort(-np.abs(combinations[-1]))[:3]
        together = [PARAMETERS[columns[k]] for k in strongest if abs(combinations[-1, k]) > 0.1]
        raise UnusableInputError(f"{', '.join(together)}: this image cannot tell them apart; hold one of them")
    full = np.zeros((9, 9))
    full[np.ix_(columns, columns)] = of_free
    projection = MarkerProjection(values)
    rest = (seen - projection.project(where).ravel()) / detector.pitch_m
    return MarkerFit(projection, tuple(PARAMETERS[k] for k in columns), full, float(np.sqrt(np.mean(rest**2))))
