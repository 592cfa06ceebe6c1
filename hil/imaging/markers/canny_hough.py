"""Lines of a marker plate by the steps of thesis Sec. 6.3.3: hybrid median, Canny's edges, Hough's transform, least squares.

`detect.find_marker` is measured against them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from hil.extras import extra_package
from hil.imaging.detector import Detector
from hil.imaging.markers.expected import CoarseLine, Expected, usable
from hil.imaging.markers.hybrid_median import hybrid_median
from hil.imaging.markers.plates import MarkerPlate
from hil.imaging.markers.projection import MarkerProjection

WIDEST_TURN_RAD = np.radians(6.0)
"""A line may be turned this far from where it is expected."""

ANGLE_STEP_RAD = np.radians(0.25)
"""Over the length of an image half a step is a pixel: as fine as the grid of distances."""

EDGE_SIGMA = 1.0
"""Canny's Gaussian [pixel]."""

EDGE_THRESHOLDS = (4.0, 8.0)
"""Canny's low and high threshold on Sobel's gradient, in standard deviations of an unfiltered pixel; noise alone makes about 1."""

SHARE_SEEN = 0.3
"""A line is one if this share of its expected length has both its edges."""

GATE_SHARE = 0.45
"""All lines together may be off by this share of their least distance; beyond, one is mistaken for the next."""

EDGE_REACH = 2.5
"""Edges this far [pixel] from Hough's line are fitted: its grid and a turned line's spread make about 1."""


@dataclass(frozen=True)
class Edges:
    """Edge pixels of one family of lines: `along` it and `across` it, and whether the image grows with `across` there."""

    along: np.ndarray
    across: np.ndarray
    grows: np.ndarray


@dataclass(frozen=True)
class CoarsePoints:
    """Result of the thesis's method: lines by least squares through edges, and crossings (n, 2) by the plate's numbers."""

    lines: dict[int, CoarseLine]
    index: np.ndarray
    pixels: np.ndarray


def coarse_points(image: np.ndarray, plate: MarkerPlate, expected: MarkerProjection, detector: Detector) -> CoarsePoints:
    """Run the first four steps alone: hybrid median, Canny, Hough, least squares."""
    counts = usable(image, detector)
    lines = _coarse_lines(counts, plate, Expected.of(plate, expected, detector))
    index, pixels = [], []
    for i in (k for k in lines if k < len(plate.x_m)):
        for j in (k for k in lines if k >= len(plate.x_m)):
            one, other = lines[i], lines[j]
            column = (one.offset + one.slope * other.offset) / (1.0 - one.slope * other.slope)
            index.append(i * len(plate.y_m) + j - len(plate.x_m))
            pixels.append((column, other.at(column)))
    return CoarsePoints(lines, np.array(index, dtype=int), np.array(pixels).reshape(-1, 2))


def edges_of(filtered: np.ndarray, image: np.ndarray) -> tuple[Edges, Edges]:
    """Find Canny's edges of lines along the rows' growing index, and of lines along the columns'.

    Counts become 2 sqrt(counts), whose noise is the same everywhere; its size is measured, so any linear unit will do.
    """
    canny = extra_package("skimage.feature", "marker plates").canny

    steady = 2.0 * np.sqrt(np.maximum(filtered, 0.0))
    sample = 2.0 * np.sqrt(np.maximum(image[::4], 0.0).astype(np.float32))
    noise = 1.4826 * float(np.median(np.abs(sample[:, 2:] - sample[:, :-2]))) / np.sqrt(2.0)
    low, high = (max(noise, 1e-6) * each for each in EDGE_THRESHOLDS)
    mask = canny(steady, sigma=EDGE_SIGMA, low_threshold=low, high_threshold=high, mode="nearest")
    mask[:2] = mask[-2:] = mask[:, :2] = mask[:, -2:] = False
    row, column = np.nonzero(mask)
    to_right = steady[row, column + 2] - steady[row, column - 2]
    down = steady[row + 2, column] - steady[row - 2, column]
    upright = np.abs(to_right) > np.abs(down)
    flat = ~upright
    return (
        Edges(row[upright], column[upright], to_right[upright] > 0.0),
        Edges(column[flat], row[flat], down[flat] > 0.0),
    )


def hough_lines(edges: Edges, shape: tuple[int, int], width: float, turn: float, length: float, apart: float) -> list[CoarseLine]:
    """Find bright lines of a known width.

    Parameters
    ----------
    edges : Edges
    shape : (along, across)
        Of the image, in the family's directions.
    width : float
        Expected width [pixel].
    turn : float
        Expected slope, as an angle [rad].
    length : float
        Expected length [pixel].
    apart : float
        Least distance of two of the plate's lines [pixel]; a scratch halfway between two is a line of its own.
    """
    hough_line = extra_package("skimage.transform", "marker plates").hough_line

    # (6.10) with u across the lines and v along them: r = across cos(theta) + along sin(theta), so that slope = -tan(theta)
    angles = -turn + np.arange(-WIDEST_TURN_RAD, WIDEST_TURN_RAD + 1e-9, ANGLE_STEP_RAD)
    votes = []
    distances = np.empty(0)
    for grows in (True, False):
        mask = np.zeros(shape, dtype=bool)
        chosen = edges.grows == grows
        mask[edges.along[chosen], edges.across[chosen]] = True
        counts, _, distances = hough_line(mask, theta=angles)
        votes.append(ndimage.maximum_filter1d(counts.astype(np.int32), 3, axis=0))
    half = max(1, round(0.5 * width))
    both = np.zeros_like(votes[0])  # brighter half a width before, darker half a width after
    both[half:-half] = np.minimum(votes[0][: -2 * half], votes[1][2 * half :])
    both[~(both > SHARE_SEEN * length)] = 0
    best = both.max(axis=1)
    peaks = np.flatnonzero((best > 0) & (best == ndimage.maximum_filter1d(best, 2 * int(0.25 * apart) + 1)))
    lines = []
    previous = -np.inf
    for peak in peaks:
        if distances[peak] - previous < 0.25 * apart:  # a peak with a flat top is one line
            continue
        previous = distances[peak]
        at_best = np.flatnonzero(both[peak] == best[peak])
        theta = angles[at_best].mean()
        lines.append(CoarseLine(float(distances[peak] / np.cos(theta)), float(-np.tan(theta))))
    return lines


def fit_edges(edges: Edges, line: CoarseLine, width: float, keep: np.ndarray) -> CoarseLine | None:
    """Fit least squares (6.11) through either edge of a line; the line is their mean.

    Parameters
    ----------
    keep : (along,) bool array
        Places along the line that are far enough from others to be relied on.

    Returns
    -------
    CoarseLine or None
        None: too few edges.
    """
    distance = edges.across - line.at(edges.along)
    both = []
    for grows, side in ((True, -0.5 * width), (False, 0.5 * width)):
        chosen = (np.abs(distance - side) < EDGE_REACH) & (edges.grows == grows) & keep[edges.along]
        along, across = edges.along[chosen].astype(float), edges.across[chosen].astype(float)
        for _ in range(2):
            if len(along) < 10 or np.ptp(along) < 20.0:
                return None
            slope, offset = np.polyfit(along, across, 1)
            rest = np.abs(across - offset - slope * along)
            near = rest < max(1.0, 3.0 * float(np.median(rest)))
            along, across = along[near], across[near]
        both.append((offset, slope))
    (one, its_slope), (other, other_slope) = both
    return CoarseLine(float(0.5 * (one + other)), float(0.5 * (its_slope + other_slope)))


def matched(lines: list[CoarseLine], expected: np.ndarray, middle: float, gate: float) -> dict[int, CoarseLine]:
    """Match the found lines to those of the drawing.

    Parameters
    ----------
    expected : (n,) array
        Where the drawing's lines are expected at `middle` along them; a common shift is allowed.
    gate : float
        The common shift, and each line's distance from its place after it, are below this [pixel].
    """
    if not lines:
        return {}
    places = np.array([line.at(middle) for line in lines])
    differences = places[:, None] - expected[None, :]
    shifts = differences[np.abs(differences) < gate]
    if not len(shifts):
        return {}
    agree = (np.abs(shifts[:, None] - shifts[None, :]) < 0.25 * gate).sum(axis=1)
    leading = shifts[agree == agree.max()]
    shift = float(np.median(leading))
    result = {}
    for k, place in enumerate(expected + shift):
        nearest = int(np.argmin(np.abs(places - place)))
        if abs(places[nearest] - place) < 0.5 * gate and int(np.argmin(np.abs(places[nearest] - expected - shift))) == k:
            result[k] = lines[nearest]
    return result


def _coarse_lines(counts: np.ndarray, plate: MarkerPlate, seen: Expected) -> dict[int, CoarseLine]:
    count = len(plate.x_m)
    families = edges_of(hybrid_median(counts), counts)
    found: dict[int, CoarseLine] = {}
    for edges, numbers, shape in zip(families, (range(count), range(count, plate.lines)), (counts.shape, counts.shape[::-1]), strict=True):
        found |= _family(edges, np.array(numbers), shape, seen)
    offset, slope = np.full((2, plate.lines), np.nan)
    for k, line in found.items():
        offset[k], slope[k] = line.offset, line.slope
    result = {}
    for k, line in found.items():
        fitted = fit_edges(families[k >= count], line, seen.width[k], seen.clear(k, offset, slope) == 1.0)
        if fitted is not None:
            result[k] = fitted
    return result


def _family(edges: Edges, numbers: np.ndarray, shape: tuple[int, int], seen: Expected) -> dict[int, CoarseLine]:
    """Return Hough's lines of one direction by the plate's numbers."""
    middle = 0.5 * (shape[0] - 1)
    places = np.array([seen.ends[k, 0, 1] + seen.slope(k) * (middle - seen.ends[k, 0, 0]) for k in numbers])
    apart = float(np.diff(np.sort(places)).min())
    inside = np.minimum(seen.ends[numbers, 1, 0], shape[0] - 1) - np.maximum(seen.ends[numbers, 0, 0], 0.0)
    turn = float(np.arctan(np.mean([seen.slope(k) for k in numbers])))
    lines = hough_lines(edges, shape, float(seen.width[numbers].mean()), turn, float(inside.mean()), apart)
    return {int(numbers[k]): line for k, line in matched(lines, places, middle, GATE_SHARE * apart).items()}
