"""Pose of every exposure from where a phantom's bullets are seen: six parameters with the source held, or all nine, with covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.optimize import brentq, linear_sum_assignment

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam

SIX, NINE = slice(3, 9), slice(0, 9)
"""Deviations that are fitted: phantom and rotation, or source too."""

FEWEST = {"six": 5, "nine": 8}
"""Bullets an exposure needs: two coordinates each, at least four more than parameters, so that a wrong one shows."""

STEPS = 12

OUTLIER = 5.0
"""A bullet this many standard deviations off, robustly estimated, is left out: a wrong match or an undetected overlap."""

DRAWN_M = 2e-3
"""Standard deviation of a focal spot's place about the drawing's, where it is held there: errors of assembly, and bending."""

MISFIT = 5.0
"""An exposure whose residuals exceed its bullets' deviations by this factor shows something other than this phantom."""

OVERLAP = 3.3
"""Bullets whose predicted centres are nearer than this many shadow radii disturb each other's centroid and are left out."""


@dataclass(frozen=True)
class PoseFit:
    """Geometry of N exposures, fitted.

    Attributes
    ----------
    beam : ConeBeam
    covariance : (N, 9, 9) array
        Of the deviations (`ConeBeam.moved`) [m, rad]; zero for a source that was held, whose own error is in the others'; NaN where an
        exposure could not be used.
    shared : (N, 9, 9) array
        The part of it that exposures of one pose share, so that their mean is no better: pixels cut every shadow alike, and a source that
        was held errs alike.
    residual_m : (N,) array
        Root mean square distance on the panel, per coordinate.
    used : (N,) int array
        Bullets used.
    good : (N,) bool array
        Exposures with enough bullets that fit the phantom.
    """

    beam: ConeBeam
    covariance: np.ndarray
    shared: np.ndarray
    residual_m: np.ndarray
    used: np.ndarray
    good: np.ndarray


def match_bullets(seen: np.ndarray, predicted: np.ndarray, gate: float) -> np.ndarray:
    """Assign the seen shadows to the bullets.

    A shift common to all is found first, by the vote of all pairs; then the assignment with the least sum of squared distances.

    Parameters
    ----------
    seen : (m, 2) array
        [pixel]
    predicted : (n, 2) array
        Where each bullet is expected [pixel].
    gate : float
        Farthest a shadow may lie from its prediction after the shift [pixel].

    Returns
    -------
    (n,) int array
        Index of the shadow of each bullet; -1: not seen.
    """
    matched = np.full(len(predicted), -1)
    if not len(seen):
        return matched
    offsets = (seen[:, None, :] - predicted[None, :, :]).reshape(-1, 2)
    winner = np.flatnonzero(np.linalg.norm(offsets - offsets[np.argmax(_votes(offsets, 0.5 * gate))], axis=1) < 0.5 * gate)
    shift = offsets[winner].mean(axis=0)
    cost = np.linalg.norm(seen[:, None, :] - predicted[None, :, :] - shift, axis=2) ** 2
    rows, columns = linear_sum_assignment(np.minimum(cost, gate**2))
    near = cost[rows, columns] < gate**2
    matched[columns[near]] = rows[near]
    return matched


@njit(cache=True)
def _votes(offsets: np.ndarray, reach: float) -> np.ndarray:
    """Return how many of the offsets (n, 2) are nearer to each than `reach`."""
    votes = np.zeros(len(offsets), dtype=np.int64)
    for i in range(len(offsets)):
        for j in range(len(offsets)):
            votes[i] += (offsets[i, 0] - offsets[j, 0]) ** 2 + (offsets[i, 1] - offsets[j, 1]) ** 2 < reach**2
    return votes


def too_near(predicted: np.ndarray, radius_pixels: float) -> np.ndarray:
    """Tell which bullets' shadows are disturbed by another bullet's shadow, (n,) bool."""
    distance = np.linalg.norm(predicted[:, None, :] - predicted[None, :, :], axis=2)
    np.fill_diagonal(distance, np.inf)
    hidden: np.ndarray = distance.min(axis=1) < OVERLAP * radius_pixels
    return hidden


def fit_poses(points_m: np.ndarray, observed_m: np.ndarray, sigma_m: np.ndarray, start: ConeBeam, nine: bool = False) -> PoseFit:
    """Fit every exposure by Gauss-Newton on the panel's coordinates.

    Parameters
    ----------
    points_m : (P, 3) array
        Bullets in the phantom's frame.
    observed_m : (N, P, 2) array
        Where they are seen on the panel; NaN: not seen.
    sigma_m : (N, P) array
        Standard deviation of each coordinate.
    start : ConeBeam
        Of the N exposures; its source is kept unless `nine`.
    nine : bool
        Fit the source too. With six parameters a source that moved by 1 mm turns into 0.32 mm and 0.85 mrad, and no residual shows it.

    Raises
    ------
    UnusableInputError
        Shapes that do not belong together, or no exposure with enough bullets.
    """
    count, bullets = len(start), len(points_m)
    if observed_m.shape != (count, bullets, 2) or sigma_m.shape != (count, bullets):
        raise UnusableInputError(
            f"observations {observed_m.shape}, deviations {sigma_m.shape}; {count} exposures of {bullets} bullets differ"
        )
    fitted = NINE if nine else SIX
    size = 9 if nine else 6
    present = np.isfinite(observed_m).all(axis=2) & np.isfinite(sigma_m)
    needed = FEWEST["nine" if nine else "six"]
    if not (present.sum(axis=1) >= needed).any():
        raise UnusableInputError(
            f"no exposure shows {needed} bullets (the most is {int(present.sum(axis=1).max(initial=0))}); is the phantom in the beam?"
        )
    beam = start
    further_m = 0.0
    for outer in range(2):
        good = present.sum(axis=1) >= needed
        weight = np.where(present & good[:, None], 1.0 / np.hypot(np.where(present, sigma_m, 1.0), further_m), 0.0)
        for _ in range(STEPS):
            residual = np.nan_to_num(observed_m - beam.project(points_m)) * weight[..., None]
            jacobian = _jacobian(beam, points_m, fitted) * weight[..., None, None]
            normal = np.einsum("npia,npib->nab", jacobian, jacobian) + 1e-9 * np.eye(size) * ~good[:, None, None]
            slope = np.einsum("npia,npi->na", jacobian, residual)
            change = np.zeros((count, 9))
            change[:, fitted] = np.linalg.solve(normal, slope[..., None])[..., 0] * good[:, None]
            beam = beam.moved(change)
            if np.abs(change).max() < 1e-9:
                break
        distance = np.where(weight[..., None] > 0.0, np.nan_to_num(observed_m - beam.project(points_m)), 0.0)
        standard = np.linalg.norm(distance, axis=2) / np.where(weight > 0.0, sigma_m, 1.0) / np.sqrt(2.0)
        if outer == 0:
            shown = good[:, None] & (weight > 0.0)
            spread = np.nanmedian(np.where(shown | ~good[:, None], np.where(shown, standard, 0.0), np.nan), axis=1, keepdims=True)
            present = present & ~(standard > OUTLIER * np.maximum(spread, 1.0))
            further_m = _further(np.where(present & good[:, None], standard, np.nan), sigma_m, size)
    used = (weight > 0.0).sum(axis=1)
    good &= np.sum(standard**2, axis=1) * 2.0 < MISFIT**2 * np.maximum(2 * used - size, 1)
    inverse = np.linalg.inv(normal)
    covariance, shared = np.zeros((2, count, 9, 9))
    covariance[:, fitted, fitted] = inverse
    # of what is in the weights the photons' part averages away
    photons = np.where(weight > 0.0, weight * sigma_m, 0.0)[..., None, None] * jacobian
    shared[:, fitted, fitted] = inverse - inverse @ np.einsum("npia,npib->nab", photons, photons) @ inverse
    if not nine:
        by_source = _jacobian(beam, points_m, slice(0, 3)) * weight[..., None, None]
        taken = inverse @ np.einsum("npia,npib->nab", jacobian, by_source)
        bias = DRAWN_M**2 * taken @ np.swapaxes(taken, 1, 2)
        covariance[:, fitted, fitted] += bias
        shared[:, fitted, fitted] += bias
    covariance[~good] = shared[~good] = np.nan
    residual_m = np.sqrt(np.sum(distance**2, axis=(1, 2)) / np.maximum(2 * used, 1))
    return PoseFit(beam, covariance, shared, np.where(good, residual_m, np.nan), used, good)


def _further(standard: np.ndarray, sigma_m: np.ndarray, size: int) -> float:
    """Return the deviation of every coordinate beside its bullet's own that explains residuals as large as these [m]; 0 if none is needed.

    Pixels sample every bullet's edge in a phase of its own, which photons' deviations leave out. `standard` (N, P) has the residuals in
    bullets' deviations, per coordinate, NaN where there is none; most exposures are to show the phantom.
    """
    seen = np.isfinite(standard)
    freedom = 2 * seen.sum(axis=1) - size
    those = freedom > 0
    if not those.any():
        return 0.0
    squares, variance = np.where(seen, standard, 0.0)[those] ** 2, np.where(seen, sigma_m, 1.0)[those] ** 2

    def excess(further: float) -> float:
        return float(np.median(2.0 * np.sum(squares * variance / (variance + further), axis=1) / freedom[those])) - 1.0

    highest = float(variance.max())
    if excess(0.0) <= 0.0:
        return 0.0
    while excess(highest) > 0.0:
        highest *= 4.0
    return float(np.sqrt(brentq(excess, 0.0, highest, rtol=1e-3)))


def _jacobian(beam: ConeBeam, points_m: np.ndarray, fitted: slice) -> np.ndarray:
    """Return the change (N, P, 2, size) of the panel coordinates with each fitted deviation of `ConeBeam.moved`."""
    arm = points_m @ beam.rotation  # from the phantom's origin, in the detector's frame
    seen = arm + beam.phantom_m[:, None, :]
    source = beam.source_m[:, None, :]
    below = source[..., 2] - seen[..., 2]
    share = source[..., 2] / below
    aside = (seen[..., :2] - source[..., :2]) / below[..., None]
    result = np.zeros((*seen.shape[:2], 2, 9))
    for k in range(2):
        result[..., k, k] = 1.0 - share
        result[..., k, 3 + k] = share
        result[..., k, 2] = aside[..., k] * (1.0 - share)
        result[..., k, 5] = aside[..., k] * share
    by_point = result[..., 3:6]
    # a turn of the detector moves what it sees by the arm's cross product with it
    result[..., 6:] = np.cross(by_point, arm[..., None, :])
    return result[..., fitted]


def observe(
    found: np.ndarray,
    variance: np.ndarray,
    points_m: np.ndarray,
    beam: ConeBeam,
    detector: Detector,
    radius_pixels: float,
    gate: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return one exposure's shadows as observations of the bullets.

    Parameters
    ----------
    found : (m, 2) array
        [pixel]
    variance : (m,) array
        [pixel^2]
    points_m : (P, 3) array
    beam : ConeBeam
        Of this one exposure, as it is expected.
    detector : Detector
    radius_pixels, gate : float

    Returns
    -------
    observed_m : (P, 2) array
        NaN: not seen, or disturbed by a neighbour.
    sigma_m : (P,) array
    """
    predicted = detector.to_pixels(beam.project(points_m)[0])
    matched = match_bullets(found, predicted, gate)
    usable = (matched >= 0) & ~too_near(predicted, radius_pixels)
    observed = np.full((len(points_m), 2), np.nan)
    sigma = np.full(len(points_m), np.nan)
    observed[usable] = detector.to_metres(found[matched[usable]])
    sigma[usable] = np.sqrt(variance[matched[usable]]) * detector.pitch_m
    return observed, sigma
