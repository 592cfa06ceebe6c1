"""What has changed in the geometry of a scan, as slow deviations over its arc, so that its images contradict each other least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hil.calibration.consistency.epipolar import PLANES, Pairs, pairs_of, said, visible_radius
from hil.calibration.consistency.plane_derivatives import PlaneDerivatives, plane_derivatives
from hil.errors import UnusableInputError
from hil.imaging.circular import advancing, scan_circle
from hil.imaging.detector import Detector
from hil.imaging.geometry import DEVIATIONS, ConeBeam

ORDER = 4
"""Highest degree of the polynomials over the arc: gravity's pull on an arm has one and two periods a turn."""
PRIOR = np.full(9, 2e-3)
"""Standard deviations [m, rad] of what may have changed, those of a mount; of degree n, 1 / (n + 1) of it."""
MOST_IMAGES = 48
WIDEST = 320
"""Most columns of an image: the planes' derivatives are smooth."""
STEP = 0.02
"""Of PRIOR: a difference that a derivative is taken over."""
ROUNDS = 3
"""Of a fit with the noise that the last one left."""
BORDER = 0.1
"""Line integral at an image's border over its largest: above, something reaches beyond the panel."""
BORDER_PIXELS = 8
"""Neighbours at the border that are averaged, against photon noise."""


@dataclass(frozen=True)
class Consistent:
    """A recalibrated scan.

    Attributes
    ----------
    deviation : (N, 9) array
        Of every exposure from the geometry that it began from, as `ConeBeam.moved` takes it.
    covariance : (N, 9, 9) array
        What the images do not show (the whole scan's place and size) stays at the geometry before, with the prior's deviation.
    images, pairs : int
        That were compared.
    before, after : float
        Root mean square of the contradictions over that of what an image says.
    """

    deviation: np.ndarray
    covariance: np.ndarray
    images: int
    pairs: int
    before: float
    after: float


def recalibrate(
    images: np.ndarray,
    detector: Detector,
    beam: ConeBeam,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Consistent:
    """Find slow deviations of a circular scan's geometry from its own images.

    Parameters
    ----------
    images : (N, rows, columns) array
        Line integrals of any object that lies within the panel's view.
    detector : Detector
    beam : ConeBeam
        Geometry (N,) to begin from, nominal or of an earlier calibration, a few millimetres off.
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
    coarse, panel = _coarser(images[chosen], detector)
    _require_whole(coarse, chosen)
    total = len(chosen) + ROUNDS
    known = plane_derivatives(coarse, panel, beam[chosen], lambda done, _: progress(done, total))
    pairs = pairs_of(beam[chosen], visible_radius(beam[chosen], panel))
    along = legendre.legvander((2.0 * angle - angle.min() - angle.max()) / np.ptp(angle), ORDER)
    scale = PRIOR / (1.0 + np.arange(ORDER + 1))[:, None]
    seen, unseen = _directions(beam[chosen], along[chosen], scale)
    fit = _Fit(known, pairs, beam[chosen], along[chosen], scale, seen)
    x = np.zeros(seen.shape[1])
    before = fit.contradictions(x)
    noise = float(np.sqrt(np.mean(before**2)))
    if noise == 0.0:
        raise UnusableInputError("the images show nothing: every pixel has the same line integral")
    for number in range(ROUNDS):
        found = least_squares(lambda x, s=noise: fit.misfit(x, s), x, lambda x, s=noise: fit.slope(x, s), x_scale=1.0, max_nfev=20)
        x = found.x
        covariance, crowding = fit.covariance(x, noise)
        noise *= float(np.sqrt(crowding))
        progress(len(chosen) + number + 1, total)
    covariance = seen @ covariance @ seen.T + unseen @ unseen.T
    spread = np.einsum("na,ij->naij", along, np.eye(9)).transpose(0, 2, 1, 3).reshape(len(beam), 9, -1) * scale.ravel()
    moved = beam[chosen]
    signal = float(np.sqrt(np.mean(said(known, pairs, moved[pairs.first], moved[pairs.second])[0] ** 2)))
    return Consistent(
        deviation=along @ ((seen @ x).reshape(scale.shape) * scale),
        covariance=spread @ covariance @ np.swapaxes(spread, 1, 2),
        images=len(chosen),
        pairs=len(pairs.first),
        before=float(np.sqrt(np.mean(before**2))) / signal,
        after=float(np.sqrt(np.mean(fit.contradictions(x) ** 2))) / signal,
    )


@dataclass(frozen=True)
class _Fit:
    """Coefficients x of what the images show, in units of the prior, the contradictions that they leave, and their slopes."""

    known: PlaneDerivatives
    pairs: Pairs
    beam: ConeBeam
    along: np.ndarray
    scale: np.ndarray
    seen: np.ndarray

    def _moved(self, x: np.ndarray) -> ConeBeam:
        return self.beam.moved(self.along @ ((self.seen @ x).reshape(self.scale.shape) * self.scale))

    def contradictions(self, x: np.ndarray) -> np.ndarray:
        moved = self._moved(x)
        first, second = said(self.known, self.pairs, moved[self.pairs.first], moved[self.pairs.second])
        apart: np.ndarray = first - second
        return apart

    def misfit(self, x: np.ndarray, noise: float) -> np.ndarray:
        return np.concatenate([self.contradictions(x).ravel() / noise, x])

    def slope(self, x: np.ndarray, noise: float) -> np.ndarray:
        return np.concatenate([self._slopes(x).reshape(-1, x.size) / noise, np.eye(x.size)])

    def _slopes(self, x: np.ndarray) -> np.ndarray:
        """Return derivatives (P, PLANES, x) of the contradictions."""
        moved = self._moved(x)
        sides = [moved[self.pairs.first], moved[self.pairs.second]]
        slopes = np.zeros((len(self.pairs.first), PLANES, *self.scale.shape))
        for side, image in enumerate((self.pairs.first, self.pairs.second)):
            for k in range(len(DEVIATIONS)):
                step = np.zeros((1, len(DEVIATIONS)))
                step[0, k] = STEP * PRIOR[k]
                ends = []
                for sign in (1.0, -1.0):
                    both = list(sides)
                    both[side] = sides[side].moved(sign * step)
                    first, second = said(self.known, self.pairs, *both)
                    ends.append(first - second)
                rate = (ends[0] - ends[1]) / (2.0 * step[0, k])
                slopes[:, :, :, k] += rate[..., None] * (self.along[image] * self.scale[:, k])[:, None]
        of_shown: np.ndarray = slopes.reshape(*slopes.shape[:2], -1) @ self.seen
        return of_shown

    def covariance(self, x: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
        """Return the covariance of x, and by how much its noise is larger than that of independent contradictions, as a variance.

        An image's errors are common to all its pairs and neighbouring planes. So each image is left out in turn with its pairs, by one
        step of the normal equations (the jackknife; Miller 1974). The prior's bias is that of a truth drawn from it.
        """
        slopes, left = self._slopes(x) / noise, self.contradictions(x) / noise
        information = np.einsum("pka,pkb->pab", slopes, slopes)
        pull = np.einsum("pka,pk->pa", slopes, left)
        posterior = np.linalg.inv(information.sum(axis=0) + np.eye(x.size))
        count = len(self.beam)
        moves = np.zeros((count, x.size))
        for image in range(count):
            own = (self.pairs.first == image) | (self.pairs.second == image)
            moves[image] = np.linalg.solve(np.linalg.inv(posterior) - information[own].sum(axis=0), pull[own].sum(axis=0))
        moves -= moves.mean(axis=0)
        scatter = (count - 1) / count * moves.T @ moves
        expected = posterior @ information.sum(axis=0) @ posterior
        crowding = float(np.trace(np.linalg.solve(expected, scatter))) / x.size
        return scatter + posterior @ posterior, crowding


def _directions(beam: ConeBeam, along: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bases (x, y) and (x, 7) of what images show of the coefficients, and of what they do not: the scan's place and size."""
    moves = []
    for k in range(3):
        step = 1e-4 * np.eye(3)[k]
        moves.append(beam.referred_to(step, np.eye(3)).deviation_from(beam))
        moves.append(beam.referred_to(np.zeros(3), Rotation.from_rotvec(step).as_matrix()).deviation_from(beam))
    larger = np.zeros((len(beam), len(DEVIATIONS)))
    larger[:, 3:6] = 1e-4 * (beam.phantom_m - beam.source_m)
    moves.append(larger)
    coefficients = [(np.linalg.lstsq(along, move, rcond=None)[0] / scale).ravel() for move in moves]
    every, _, _ = np.linalg.svd(np.column_stack(coefficients))
    return every[:, len(moves) :], every[:, : len(moves)]


def _coarser(images: np.ndarray, detector: Detector) -> tuple[np.ndarray, Detector]:
    """Return images of at most WIDEST columns, and their panel."""
    factor = next(
        (n for n in range(1, detector.columns) if not (detector.columns % n or detector.rows % n) and detector.columns <= n * WIDEST), 1
    )
    rows, columns = detector.rows // factor, detector.columns // factor
    return images.reshape(len(images), rows, factor, columns, factor).mean(axis=(2, 4)), detector.binned(factor)


def _require_whole(images: np.ndarray, numbers: np.ndarray) -> None:
    """Refuse images beyond whose border the object goes on: what another image sees of it there is not in them."""
    border = np.concatenate([images[:, 0], images[:, :, -1], images[:, -1, ::-1], images[:, ::-1, 0]], axis=1)  # once around
    border = uniform_filter1d(border, BORDER_PIXELS, axis=1, mode="wrap").max(axis=1)
    cut = np.flatnonzero(border > BORDER * images.max(axis=(1, 2)))
    if len(cut):
        raise UnusableInputError(
            f"image {numbers[cut[0]]} and {len(cut) - 1} others are cut off by the panel's border: the object must be whole in every image"
        )
