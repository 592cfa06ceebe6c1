"""By how much pairs of images contradict each other, what noise explains of it, and how it changes with the geometry.

A difference of two plane derivatives is divided by the deviation that photons and each image's relative error leave in it. Without that, an
image seems to agree best where it is least noisy. The same image takes part in many pairs: the slopes' sum varies as independent images
do, not pairs, and its covariance is found from drawn noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from hil.calibration.consistency.epipolar import PLANES, Lines, Pairs, lines_of
from hil.calibration.consistency.plane_derivatives import PlaneDerivatives, read
from hil.imaging.geometry import DEVIATIONS, ConeBeam

STEP = 4e-5
"""Half a difference [m, rad] that a derivative is taken over."""
FLOOR = 0.03
"""Of the median variance: the least, where lines miss what is seen."""
ROUNDS = 4
"""Of weighted least squares for the relative errors."""


@dataclass(frozen=True)
class Evidence:
    """What the contradictions say of coefficients x, about the place where they were taken.

    Attributes
    ----------
    information : (n, n) array
        The expected curvature H, without what noise adds to squared slopes.
    score : (n,) array
        H x - g, with g the slope of half the sum of squares.
    covariance : (n, n) array
        Of the score, by the model of the noise.
    crowding : float
        By how much the score's covariance as measured over images exceeds that.
    size : float
        Root mean square of a contradiction over its deviation.
    """

    information: np.ndarray
    score: np.ndarray
    covariance: np.ndarray
    crowding: float
    size: float


class Contradictions:
    """Those of one scan, whose geometry (N,) moves by `course` (N, 9, n) times coefficients x."""

    def __init__(self, tables: PlaneDerivatives, pairs: Pairs, beam: ConeBeam, course: np.ndarray) -> None:
        self._tables, self._pairs, self._beam, self._course = tables, pairs, beam, course
        variance = np.sum(self._variances(lines_of(tables, pairs, beam[pairs.first], beam[pairs.second]), tables.variance), axis=0)
        seen = variance[variance > 0.0]
        self._floor = FLOOR * float(np.median(seen)) if len(seen) else 0.0
        self.relative = np.zeros(len(beam))

    def _sides(self, x: np.ndarray) -> tuple[ConeBeam, ConeBeam]:
        moved = self._beam.moved(self._course @ x)
        return moved[self._pairs.first], moved[self._pairs.second]

    def _variances(self, lines: tuple[Lines, Lines], table: np.ndarray) -> list[np.ndarray]:
        return [each.factor**2 * read(table, each.places) for each in lines]

    def _deviation(self, lines: tuple[Lines, Lines]) -> np.ndarray:
        """Return the deviation (P, K) of a pair's difference."""
        total = self._floor + np.sum(self._variances(lines, self._tables.variance), axis=0)
        envelopes = self._variances(lines, self._tables.envelope)
        for each, image in zip(envelopes, (self._pairs.first, self._pairs.second), strict=True):
            total = total + self.relative[image][:, None] ** 2 * each
        deviation: np.ndarray = np.sqrt(total)
        return deviation

    def _differences(self, sides: tuple[ConeBeam, ConeBeam], tables: list[np.ndarray]) -> list[np.ndarray]:
        """Return contradictions (P, K) over their deviations, in each of some tables."""
        lines = lines_of(self._tables, self._pairs, *sides)
        deviation = self._deviation(lines)
        one, other = lines
        return [(one.factor * read(table, one.places) - other.factor * read(table, other.places)) / deviation for table in tables]

    def fit_relative_errors(self, x: np.ndarray) -> None:
        """Find each image's relative error, from what noise does not explain of its contradictions."""
        lines = lines_of(self._tables, self._pairs, *self._sides(x))
        one, other = self._variances(lines, self._tables.envelope)
        noise = self._floor + np.sum(self._variances(lines, self._tables.variance), axis=0)
        apart = [each.factor * read(self._tables.known, each.places) for each in lines]
        surplus = (apart[0] - apart[1]) ** 2 - noise
        first, second, count = self._pairs.first, self._pairs.second, len(self._beam)
        squared = np.zeros(count)
        for _ in range(ROUNDS):
            weight = (noise + squared[first][:, None] * one + squared[second][:, None] * other) ** -2
            normal, right = np.zeros((count, count)), np.zeros(count)
            for image, own in ((first, one), (second, other)):
                np.add.at(normal, (image, image), (weight * own**2).sum(axis=1))
                np.add.at(right, image, (weight * own * surplus).sum(axis=1))
            mixed = (weight * one * other).sum(axis=1)
            np.add.at(normal, (first, second), mixed)
            np.add.at(normal, (second, first), mixed)
            root = np.linalg.cholesky(normal + 1e-9 * np.trace(normal) / count * np.eye(count))
            squared, _ = nnls(root.T, np.linalg.solve(root, right))
        self.relative = np.sqrt(squared)

    def evidence(self, x: np.ndarray) -> Evidence:
        """Return what the contradictions say about x."""
        sides = self._sides(x)
        drawn = self._tables.noise + self.relative[:, None, None].astype(np.float32) * self._tables.relative
        tables = [self._tables.known, *drawn]
        ends = self._differences(sides, tables)
        slopes, of_noise = self._slopes(sides, [tables[0], tables[-1]])
        own, total = self._summed(ends[0], slopes)
        images = len(self._beam)
        covariance = np.zeros((x.size, x.size))
        lines = lines_of(self._tables, self._pairs, *sides)
        deviation = self._deviation(lines)
        for table in drawn[:-1]:
            of_image = np.zeros((images, x.size))
            for sign, each, image in zip((1.0, -1.0), lines, (self._pairs.first, self._pairs.second), strict=True):
                np.add.at(of_image, image, self._summed(sign * each.factor * read(table, each.places) / deviation, slopes)[0])
            covariance += of_image.T @ of_image / (len(drawn) - 1)
        information = self._normal(slopes) - self._normal(of_noise)
        shared = np.zeros((images, x.size))  # pairs that share an image err together (Aronow, Samii, Assenova 2015)
        np.add.at(shared, self._pairs.first, own)
        np.add.at(shared, self._pairs.second, own)
        measured = shared.T @ shared - own.T @ own
        covariance += 1e-9 * np.trace(covariance) / x.size * np.eye(x.size)
        return Evidence(
            information=information,
            score=information @ x - total,
            covariance=covariance,
            crowding=float(np.trace(np.linalg.solve(covariance, measured))) / x.size,
            size=float(np.sqrt(np.mean(ends[0][ends[0] != 0.0] ** 2))) if (ends[0] != 0.0).any() else 0.0,
        )

    def _slopes(self, sides: tuple[ConeBeam, ConeBeam], tables: list[np.ndarray]) -> list[np.ndarray]:
        """Return derivatives (P, PLANES, 18) of contradictions by both images' nine parameters, in each of some tables."""
        count = len(DEVIATIONS)
        slopes = [np.zeros((len(self._pairs.first), PLANES, 2 * count)) for _ in tables]
        for side in range(2):
            for k in range(count):
                step = STEP * np.eye(count)[k][None]
                ends = []
                for sign in (1.0, -1.0):
                    both = list(sides)
                    both[side] = sides[side].moved(sign * step)
                    ends.append(self._differences((both[0], both[1]), tables))
                for each, ahead, behind in zip(slopes, *ends, strict=True):
                    each[..., side * count + k] = (ahead - behind) / (2.0 * STEP)
        return slopes

    def _summed(self, differences: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return each pair's sum (P, n) of differences times slopes by the coefficients, and all pairs' (n,)."""
        by_parameter = np.einsum("pk,pka->pa", differences, slopes)
        count = len(DEVIATIONS)
        own = np.einsum("pa,pan->pn", by_parameter[:, :count], self._course[self._pairs.first])
        own += np.einsum("pa,pan->pn", by_parameter[:, count:], self._course[self._pairs.second])
        return own, own.sum(axis=0)

    def _normal(self, slopes: np.ndarray) -> np.ndarray:
        """Return the sum (n, n) of squared slopes by the coefficients."""
        blocks = np.swapaxes(slopes, 1, 2) @ slopes  # (P, 18, 18)
        images, count, size = self._course.shape
        whole = np.zeros((images, images, count, count))
        first, second = self._pairs.first, self._pairs.second
        np.add.at(whole, (first, first), blocks[:, :count, :count])
        np.add.at(whole, (first, second), blocks[:, :count, count:])
        np.add.at(whole, (second, first), blocks[:, count:, :count])
        np.add.at(whole, (second, second), blocks[:, count:, count:])
        flat = self._course.reshape(images * count, size)
        normal: np.ndarray = flat.T @ whole.transpose(0, 2, 1, 3).reshape(images * count, -1) @ flat
        return normal
