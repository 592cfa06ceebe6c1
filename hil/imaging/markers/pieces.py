"""Grooves piece by piece: where a groove lies across short pieces of it, each with a background and a contrast of its own.

Behind a plate the anatomy dims a groove and its surroundings alike, so the model of a piece is a product: a background that varies slowly
across, times one plus a contrast where the groove is. What varies fast (a wire, a bone's edge) fails to fit or puts the piece out of line
with the others; the pieces beside it stay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numba import njit

BIN = 0.5
"""Bins of a profile across a groove [pixel]; the mean place of each bin's pixels is kept: a bin's width costs resolution alone."""

REACH = 1.75
"""A profile reaches this many grooves' widths to either side."""

FADE = 0.4
"""Share of the reach over which pixels count less and less: a line that moves by a hair must not take in a whole column of pixels."""

SIZE = 6
"""Parameters of a piece: place, contrast, background (level, slope, curvature across), slope of the contrast across.

Anatomy dims a groove and its surroundings by one factor, which leaves the contrast as it is; scatter brightens both by one amount, so that
the contrast falls as the background grows. The slope is held, as by a measurement, to zero within what scatter alone would make of it."""

STEPS = 5
SETTLED_PIXELS = 2e-4
"""Steps shrink at least tenfold; what is left is below the photons' noise."""

OUTLIER = 6.0
"""A pixel this many standard deviations from its neighbours along the groove is dead, or under a wire that crosses."""

FEWEST_BINS = SIZE + 2

TABLE_STEP = 1.0 / 16.0
"""Spacing of the tabulated profile [pixel]; linear between, to 1e-3 of the contrast for a blur of half a pixel."""


@dataclass(frozen=True)
class Profiles:
    """Counts across the pieces of lines, in bins.

    Attributes
    ----------
    along : (P,) array
        Mean place of each piece [pixel].
    line : (P,) array
        Where the profile's zero lies across, at `along`.
    counts, number, place : (P, bins) arrays
        Mean counts, pixels (in part, where they count in part), and mean distance from zero.
    """

    along: np.ndarray
    line: np.ndarray
    counts: np.ndarray
    number: np.ndarray
    place: np.ndarray

    @classmethod
    def none(cls, reach: float) -> Profiles:
        """Return no piece, with the bins of this reach."""
        empty = np.zeros((0, _bins(reach)))
        return cls(np.zeros(0), np.zeros(0), empty, empty, empty)


@dataclass(frozen=True)
class Pieces:
    """Fitted pieces of lines.

    Attributes
    ----------
    along, across : (P,) arrays
        Place [pixel].
    variance : (P,) array
        Of `across` by the photons [pixel^2]; infinite where nothing like a groove was found.
    misfit : (P,) array
        Sum of squares over degrees of freedom, in units of the photons' noise.
    values : (P, SIZE) array
        Place from the profile's zero, contrast, background, slope of the contrast.
    contrast_sigma : (P,) array
    """

    along: np.ndarray
    across: np.ndarray
    variance: np.ndarray
    misfit: np.ndarray
    values: np.ndarray
    contrast_sigma: np.ndarray


@njit(cache=True)
def split(share: np.ndarray, length: float) -> np.ndarray:
    """Return the number of the piece each place along a line belongs to, -1 where its share is nothing; pieces are about `length` long.

    Lengths are sums of shares, which change by a little where a line moves by a little: so does their number seldom.
    """
    number = np.full(len(share), -1, dtype=np.int64)
    count = first = 0
    total = 0.0
    for k in range(len(share) + 1):
        if k < len(share) and share[k] > 0.0:
            total += share[k]
            continue
        parts = int(np.rint(total / length))
        before = 0.0
        for each in range(first, k if parts else first):
            number[each] = count + min(int((before + 0.5 * share[each]) / total * parts), parts - 1)
            before += share[each]
        count += parts
        first, total = k + 1, 0.0
    return number


def profiles(
    image: np.ndarray,
    offset: float,
    slope: float,
    piece: np.ndarray,
    reach: float,
    share: np.ndarray | None = None,
    stride: int = 1,
    fade: float = 0.0,
) -> Profiles:
    """Gather profiles across a line.

    Parameters
    ----------
    image : (along, across) array
        Of 16 bits or float32, and contiguous: turned over for a line that runs along the columns' growing index.
    offset, slope : float
        across = offset + slope * along.
    piece : (along,) int array
        Of `split`.
    reach : float
        To either side [pixel].
    share : (along,) array, optional
        What each place counts for; without it 1.
    stride : int
        Every so many places along are looked at.
    fade : float
        Share of the reach over which pixels count less and less, to nothing at its end.
    """
    counted = np.ones(len(piece)) if share is None else share
    along, counts, number, place = _gather(image, offset, slope, piece, counted, reach, fade, stride)
    return Profiles(along, offset + slope * along, counts, number, place)


def together(lines: Sequence[Profiles]) -> Profiles:
    """Return the pieces of several lines, gathered with one reach, as those of one."""
    return Profiles(*(np.concatenate([getattr(each, field.name) for each in lines]) for field in fields(Profiles)))


def fit_pieces(seen: Profiles, width: np.ndarray | float, blur: float, start: Pieces | None = None) -> Pieces:
    """Fit every piece: a box of its `width` blurred by a Gaussian of `blur` [pixel], on a background.

    With `start`, the fit of these pieces with a shape not far from this one, where that is from.
    """
    count = len(seen.along)
    values = np.zeros((count, SIZE)) if start is None else start.values.copy()
    variance, misfit, contrast_sigma = np.full((3, count), np.inf)
    known = np.zeros(count, dtype=bool) if start is None else np.isfinite(start.variance)
    widths = np.broadcast_to(np.asarray(width, dtype=float), count)
    _fit(seen.counts, seen.number, seen.place, widths, blur, known, values, variance, misfit, contrast_sigma)
    return Pieces(seen.along, seen.line + values[:, 0], variance, misfit, values, contrast_sigma)


@njit(inline="always")
def _bins(reach: float) -> int:
    return math.ceil(2.0 * reach / BIN) + 1


@njit(cache=True)
def _table(width: float, blur: float) -> np.ndarray:
    """Return the profile and its derivative on a grid of `TABLE_STEP` from 0 on, (n, 2)."""
    table = np.empty((int((0.5 * width + 6.0 * blur) / TABLE_STEP) + 3, 2))
    for k in range(len(table)):
        d, root = k * TABLE_STEP, math.sqrt(2.0) * blur
        left, right = (d + 0.5 * width) / root, (d - 0.5 * width) / root
        table[k, 0] = 0.5 * (math.erf(left) - math.erf(right))
        table[k, 1] = (math.exp(-(left**2)) - math.exp(-(right**2))) / (math.sqrt(2.0 * math.pi) * blur)
    return table


@njit(cache=True, error_model="numpy")
def _gather(
    image: np.ndarray,
    offset: float,
    slope: float,
    piece: np.ndarray,
    share: np.ndarray,
    reach: float,
    fade: float,
    stride: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return mean place of each piece; mean counts, number and mean place of the pixels in its bins.

    Neighbouring pixels are two bins apart. So even and odd bins are kept apart: a row of pixels then goes to places that follow each
    other, which the processor adds several at a time.
    """
    pieces, bins = piece.max() + 1, _bins(reach)
    sums, along_sums = np.zeros((pieces, 2, 3, bins // 2 + 1)), np.zeros((pieces, 2))
    limit, one, nothing = np.float32(OUTLIER**2), np.float32(1.0), np.float32(0.0)
    far, fading = np.float32(reach), np.float32(1.0 / max(fade * reach, 1e-6))
    keep, kept = np.empty(image.shape[1], dtype=np.float32), np.empty(image.shape[1], dtype=np.float32)
    for along in range(2, len(piece) - 2, stride):
        k = piece[along]
        if k < 0:
            continue
        center = offset + slope * along
        first, last = max(0, math.ceil(center - reach)), min(image.shape[1] - 1, math.floor(center + reach))
        along_sums[k, 0] += share[along] * along
        along_sums[k, 1] += share[along]
        start, width = first - center, last + 1 - first
        near, whole = np.float32(start), np.float32(share[along])
        lowest = int((start + reach) / BIN)
        odd, j = lowest % 2, lowest // 2
        for n in range(width):
            seen = np.float32(image[along, first + n])
            a, b = np.float32(image[along - 2, first + n]), np.float32(image[along - 1, first + n])
            c, d = np.float32(image[along + 1, first + n]), np.float32(image[along + 2, first + n])
            low, high = max(min(a, b), min(c, d)), min(max(a, b), max(c, d))
            usual = max(min(low, high), min(max(low, high), seen))
            away = seen - usual
            weight = whole * max(nothing, min(one, (far - abs(near + np.float32(n))) * fading))
            keep[n] = weight if away * away <= limit * max(usual, one) else nothing
            kept[n] = keep[n] * seen
        for n in range(width):
            sums[k, odd, 0, j + n] += keep[n]
        for n in range(width):
            sums[k, odd, 1, j + n] += kept[n]
        for n in range(width):
            sums[k, odd, 2, j + n] += keep[n] * (start + n)
    middle, result = np.zeros(pieces), np.zeros((3, pieces, bins))
    for k in range(pieces):
        middle[k] = along_sums[k, 0] / max(along_sums[k, 1], 1e-3)
        for each in range(bins):
            for i in range(3):
                result[i, k, each] = sums[k, each % 2, i, each // 2]
        for each in range(bins):
            if result[0, k, each] > 0.0:
                result[1, k, each] /= result[0, k, each]
                result[2, k, each] /= result[0, k, each]
    return middle, result[1], result[0], result[2]


@njit(inline="always")
def _looked_up(table: np.ndarray, d: float) -> tuple[float, float]:
    at = abs(d) / TABLE_STEP
    j = int(at)
    if j >= table.shape[0] - 1:
        return 0.0, 0.0
    rest = at - j
    shape = table[j, 0] + rest * (table[j + 1, 0] - table[j, 0])
    slope = table[j, 1] + rest * (table[j + 1, 1] - table[j, 1])
    return shape, (slope if d >= 0.0 else -slope)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _fit(
    counts: np.ndarray, number: np.ndarray, place: np.ndarray, width: np.ndarray, blur: float, known: np.ndarray, values: np.ndarray,
    variance: np.ndarray, misfit: np.ndarray, contrast_sigma: np.ndarray,
) -> None:  # fmt: skip
    """Fit the pieces; sums run over the bins, several of which the processor adds at a time."""
    bins = counts.shape[1]
    seen, many, d, rest, weighted = np.empty(bins), np.empty(bins), np.empty(bins), np.empty(bins), np.empty(bins)
    row, normal, slope = np.empty((SIZE, bins)), np.empty((SIZE, SIZE)), np.empty(SIZE)
    table, tabulated = np.empty((0, 2)), -1.0
    for k in range(counts.shape[0]):
        gate = 0.5 * width[k]
        if width[k] != tabulated:
            table, tabulated = _table(width[k], blur), width[k]
        filled, level = 0, 0.0
        for j in range(bins):
            if number[k, j] > 0.0:
                seen[filled], many[filled], d[filled] = counts[k, j], number[k, j], place[k, j]
                filled += 1
                level += counts[k, j]
        if filled < FEWEST_BINS or not level > 0.0:
            continue
        v = values[k]
        if not known[k]:
            v[0], v[1], v[2], v[3], v[4], v[5] = 0.0, 0.8, level / filled / 1.3, 0.0, 0.0, 0.0
        total = 0.0
        for step in range(2 if known[k] else 0, STEPS):
            for j in range(filled):
                shape, by_place = _looked_up(table, d[j] - v[0])
                background, contrast = v[2] + v[3] * d[j] + v[4] * d[j] * d[j], v[1] + v[5] * d[j]
                through = 1.0 + contrast * shape
                row[0, j], row[1, j], row[2, j] = -background * contrast * by_place, background * shape, through
                row[3, j], row[4, j], row[5, j] = through * d[j], through * d[j] * d[j], background * shape * d[j]
                rest[j] = seen[j] - background * through
                # at first the counts themselves say how much they scatter, from then on the model does, which is not biased by them
                weighted[j] = many[j] / max(seen[j] if step == 0 else background * through, 1.0)
            total = 0.0
            for j in range(filled):
                total += weighted[j] * rest[j] * rest[j]
            for a in range(SIZE):
                summed = 0.0
                for j in range(filled):
                    summed += weighted[j] * row[a, j] * rest[j]
                slope[a] = summed
                for b in range(a + 1):
                    summed = 0.0
                    for j in range(filled):
                        summed += weighted[j] * row[a, j] * row[b, j]
                    normal[a, b] = normal[b, a] = summed
            stiffness = held(v)
            normal[5, 5] += stiffness
            slope[5] -= stiffness * v[5]
            determined = normal[0, 0] > 0.0
            if step == 0:  # contrast and background first, at the place that was told: both far off would be taken for the place
                normal[0, 1:], normal[1:, 0], slope[0] = 0.0, 0.0, 0.0
                normal[0, 0] = max(normal[0, 0], 1.0)
            if not determined or not solve(normal, slope):
                total = np.inf
                break
            for a in range(SIZE):
                v[a] += slope[a]
            if abs(v[0]) > gate or not v[1] > 0.0:
                total = np.inf
                break
            if step > 1 and abs(slope[0]) < SETTLED_PIXELS:
                break
        if np.isfinite(total):
            variance[k], contrast_sigma[k] = normal[0, 0], math.sqrt(normal[1, 1])
            misfit[k] = total / (filled - SIZE)


@njit(cache=True, error_model="numpy")
def solve(normal: np.ndarray, right: np.ndarray) -> bool:
    """Replace a positive definite matrix by its inverse and the right side by the solution (Gauss-Jordan); False where it is singular."""
    size = len(right)
    for i in range(size):
        pivot = normal[i, i]
        if not pivot > 0.0:
            return False
        normal[i, i] = 1.0
        for j in range(size):
            normal[i, j] /= pivot
        right[i] /= pivot
        for r in range(size):
            if r != i:
                factor = normal[r, i]
                normal[r, i] = 0.0
                for j in range(size):
                    normal[r, j] -= factor * normal[i, j]
                right[r] -= factor * right[i]
    return True


@njit(inline="always")
def held(v: np.ndarray) -> float:
    """Return how firmly a piece's slope of the contrast is held to zero."""
    by_scatter = v[1] * v[3] / v[2]
    return float(1.0 / (by_scatter**2 + 1e-12))
