"""What has changed in the geometry of a scan, as slow deviations over its arc, so that its images contradict each other least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.spatial.transform import Rotation

from hil.calibration.consistency.contradictions import Contradictions
from hil.calibration.consistency.epipolar import object_radius, pairs_of
from hil.calibration.consistency.plane_derivatives import plane_derivatives
from hil.calibration.consistency.scale import change
from hil.calibration.consistency.seen_pixels import seen_pixels
from hil.errors import UnusableInputError
from hil.imaging.circular import advancing, scan_circle
from hil.imaging.detector import Detector
from hil.imaging.geometry import DEVIATIONS, ConeBeam

ORDER = 4
"""Highest degree of the polynomials over the arc: gravity's pull on an arm has one and two periods a turn."""
WIDEST = 2e-3
"""Standard deviation [m, rad] at scale one; of degree n, 1 / (n + 1) of it."""
MOST_IMAGES = 48
MOST_COLUMNS = 640
"""Of an image: pixels are summed until it has no more."""
ROUNDS = 6
"""Most of a Gauss-Newton fit."""
ENOUGH = 0.1
"""Of the stated deviation: a step that ends it."""
LEAST_GAIN = 12.0
"""Twice a logarithm of odds that two scales of nothing reach once in a thousand scans (Self and Liang 1987)."""
POINTS = 60
"""In the object's sphere, whose shadows stand for the scan's shape."""


@dataclass(frozen=True)
class Consistent:
    """A recalibrated scan.

    Attributes
    ----------
    deviation : (N, 9) array
        Of every exposure from the geometry that it began from, as `ConeBeam.moved` takes it.
    covariance : (N, 9, 9) array
        What the images do not show (the whole scan's place and size) stays, and is as unsure as the rest may have changed.
    images, pairs : int
        That were compared.
    gain : float
        Twice the logarithm of odds that something has changed.
    before, after : float
        Root mean square of the contradictions over the deviation of their noise.
    moved_m, stated_m : float
        By how much shadows of points in the object moved on the panel, rms, the scan's place and size apart; how sure that is.
    """

    deviation: np.ndarray
    covariance: np.ndarray
    images: int
    pairs: int
    gain: float
    before: float
    after: float
    moved_m: float
    stated_m: float

    @property
    def sure(self) -> bool:
        """Whether the images say that the geometry has changed, and a table of the change is nearer to it than none.

        What is found holds its own error: of a found size m and an error s a change of m^2 - s^2 is left, and taking it up leaves s.
        """
        return self.gain > LEAST_GAIN and self.moved_m**2 > 2.0 * self.stated_m**2


def recalibrate(
    counts: Callable[[int], np.ndarray],
    detector: Detector,
    beam: ConeBeam,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Consistent:
    """Find slow deviations of a circular scan's geometry from its own images.

    Parameters
    ----------
    counts : callable
        Image (rows, columns) of an exposure's number, of any object that lies within the panel's view.
    detector : Detector
    beam : ConeBeam
        Geometry (N,) to begin from, nominal or of an earlier calibration, a millimetre off.
    progress : callable
        Told how many of how many steps are done.

    Raises
    ------
    UnusableInputError
        The scan is not circular, has fewer than ten exposures on its way, or its object reaches beyond the panel; or images show
        nothing.
    """
    _, angle = scan_circle(beam)
    moving = advancing(angle)
    chosen = moving[np.unique(np.linspace(0, len(moving) - 1, min(MOST_IMAGES, len(moving))).round().astype(int))]
    if len(chosen) < 2 * (ORDER + 1):
        raise UnusableInputError(f"{len(chosen)} exposures on the way; this needs {2 * (ORDER + 1)} at least")
    total = 2 * len(chosen) + ROUNDS
    factor = _coarser(detector)
    panel, images = detector.binned(factor), []
    for k, number in enumerate(chosen):
        binned = np.asarray(counts(int(number)), dtype=float).reshape(panel.rows, factor, panel.columns, factor).sum(axis=(1, 3))
        images.append(seen_pixels(binned, panel))
        progress(k + 1, total)
    cut = [int(number) for number, image in zip(chosen, images, strict=True) if image.cut]
    if cut:
        raise UnusableInputError(
            f"image {cut[0]} and {len(cut) - 1} others are cut off by the panel's border: the object must be whole in every image"
        )
    if not all(len(image.integral) for image in images):
        raise UnusableInputError("an image shows nothing: every pixel is as bright as its border")
    few = beam[chosen]
    tables = plane_derivatives(images, panel, few, lambda done, _: progress(len(chosen) + done, total))
    radius = object_radius(images, few)
    pairs = pairs_of(few, radius)
    along = legendre.legvander((2.0 * angle - angle.min() - angle.max()) / np.ptp(angle), ORDER)
    size = WIDEST / (1.0 + np.arange(ORDER + 1))
    course = np.einsum("nq,q,ij->niqj", along, size, np.eye(len(DEVIATIONS))).reshape(len(beam), len(DEVIATIONS), -1)
    seen, unseen = _directions(few, course[chosen])
    degree = np.repeat(np.arange(ORDER + 1), len(DEVIATIONS))
    groups = tuple(seen.T @ (chosen_degree[:, None] * seen) for chosen_degree in (degree == 0, degree > 0))
    shadows = _shadows(few, course[chosen] @ seen, radius)
    fit = Contradictions(tables, pairs, few, course[chosen] @ seen)
    x, before = np.zeros(seen.shape[1]), 0.0
    for done in range(ROUNDS):
        fit.fit_relative_errors(x)
        said = fit.evidence(x)
        before = before or said.size
        noise = max(1.0, said.crowding) * said.covariance
        told = change(said.information, said.score, noise, groups).told
        noise = max(1.0, said.crowding * len(chosen) / max(1.0, len(chosen) - told)) * said.covariance
        found = change(said.information, said.score, noise, groups)
        stated = float(np.sqrt(np.trace(shadows @ found.covariance @ shadows.T)))
        step = float(np.linalg.norm(shadows @ (found.mean - x)))
        x = found.mean
        progress(2 * len(chosen) + done + 1, total)
        if step < ENOUGH * stated:
            break
    covariance = seen @ found.covariance @ seen.T + np.mean(found.scales**2) * unseen @ unseen.T
    return Consistent(
        deviation=course @ (seen @ x),
        covariance=course @ covariance @ np.swapaxes(course, 1, 2),
        images=len(chosen),
        pairs=len(pairs.first),
        gain=found.gain,
        before=before,
        after=said.size,
        moved_m=float(np.linalg.norm(shadows @ x)),
        stated_m=stated,
    )


def _similarity(beam: ConeBeam) -> np.ndarray:
    """Return deviations (N, 9, 7) that move, turn and enlarge the whole scan, which no image shows."""
    moves = []
    for k in range(3):
        step = 1e-4 * np.eye(3)[k]
        moves.append(beam.referred_to(step, np.eye(3)).deviation_from(beam))
        moves.append(beam.referred_to(np.zeros(3), Rotation.from_rotvec(step).as_matrix()).deviation_from(beam))
    larger = np.zeros((len(beam), len(DEVIATIONS)))
    larger[:, 3:6] = 1e-4 * (beam.phantom_m - beam.source_m)
    return np.stack([*moves, larger], axis=-1)


def _directions(beam: ConeBeam, course: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bases of coefficients that images show, and of those that they do not: the scan's place and size."""
    moves = _similarity(beam)
    coefficients = np.linalg.lstsq(course.reshape(-1, course.shape[-1]), moves.reshape(-1, moves.shape[-1]), rcond=None)[0]
    every, _, _ = np.linalg.svd(coefficients)
    return every[:, moves.shape[-1] :], every[:, : moves.shape[-1]]


def _shadows(beam: ConeBeam, course: np.ndarray, radius_m: float) -> np.ndarray:
    """Return shifts of shadows [m] by coefficients, whose norm is a root mean square, the scan's place and size apart."""
    points = np.random.default_rng(0).standard_normal((POINTS, 3))
    points *= (radius_m * np.random.default_rng(1).random(POINTS) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
    at = beam.project(points)

    def shifts(moves: np.ndarray) -> np.ndarray:
        step = 1e-3
        return np.stack([(beam.moved(step * move).project(points) - at).ravel() / step for move in np.moveaxis(moves, -1, 0)], axis=-1)

    common, _ = np.linalg.qr(shifts(_similarity(beam)))
    own = shifts(course)
    shape: np.ndarray = (own - common @ (common.T @ own)) / np.sqrt(len(beam) * POINTS)
    return shape


def _coarser(detector: Detector) -> int:
    """Return how many pixels of a row become one."""
    whole = (n for n in range(1, detector.columns) if not (detector.columns % n or detector.rows % n))
    return next((n for n in whole if detector.columns <= n * MOST_COLUMNS), 1)
