"""A marker plate in an X-ray image: its lines and their crossings to a small fraction of a pixel (thesis Sec. 6.3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.markers.hybrid_median import hybrid_median
from hil.imaging.markers.lines import CoarseLine, Edges, edges_of, fit_edges, hough_lines, matched
from hil.imaging.markers.plane import refused_lines
from hil.imaging.markers.plates import MarkerPlate
from hil.imaging.markers.profile import FineLine, fit_profile
from hil.imaging.markers.projection import MarkerProjection

GATE_SHARE = 0.45
"""All lines together may be off by this share of their least distance; beyond, one is mistaken for the next."""

FIRST_BLUR = 1.3
"""Where the fit of the blur starts [pixel]."""

CLEAR_OF_CROSSINGS = 5.0
"""Beyond half a groove this far [pixel] from a crossing line's middle, and from a line's end, scatter and blur have rounded the corners."""

MISFIT = 4.0
"""A line whose profile misses the image by this factor more than the lines' median is bent or crossed. Not an absolute bound: the focal
spot is no Gaussian, and the more photons, the more of that shows."""


MOST_REFUSED = 1.0 / 3.0
"""With a larger share of the lines missing or out of place it is unknown which of the others are right."""


@dataclass(frozen=True)
class MarkerPoints:
    """Crossings found in one image.

    Attributes
    ----------
    index : (n,) int array
        Which of the plate's points.
    pixels : (n, 2) array
        Column and row.
    covariance : (2n, 2n) array
        Of `pixels.ravel()` [pixel^2]; its rank is twice the number of lines: points on one line share its errors.
    lines : dict
        The fitted grooves by number; those along y come first.
    refused : dict
        Grooves found or expected and not used, by number, with the reason.
    """

    index: np.ndarray
    pixels: np.ndarray
    covariance: np.ndarray
    lines: dict[int, FineLine]
    refused: dict[int, str]


@dataclass(frozen=True)
class CoarsePoints:
    """Result of the thesis's method: lines by least squares through edges, and crossings (n, 2) by the plate's numbers."""

    lines: dict[int, CoarseLine]
    index: np.ndarray
    pixels: np.ndarray


def find_marker(image: np.ndarray, plate: MarkerPlate, expected: MarkerProjection, detector: Detector) -> MarkerPoints:
    """Find a plate's crossings.

    Parameters
    ----------
    image : (rows, columns) array
        Photon counts; grooves are brighter than the plate.
    plate : MarkerPlate
    expected : MarkerProjection
        Where it should be, to less than half the distance of two grooves and 6 degrees.
    detector : Detector

    Raises
    ------
    UnusableInputError
        The image is none of this detector, is dark or saturated, or shows too little of the plate.
    """
    counts = _usable(image, detector)
    filtered = hybrid_median(counts)
    seen = _Expected.of(plate, expected, detector)
    coarse = _coarse_lines(counts, filtered, plate, seen)
    fine: dict[int, FineLine] = {}
    refused = {k: "not found" for k in range(plate.lines) if k not in coarse}
    for k, line in coarse.items():
        keep = _clear(k, line, coarse, plate, seen, counts.shape)
        fitted = fit_profile(counts, filtered, line, seen.width[k], FIRST_BLUR, keep, k < len(plate.x_m))
        if fitted is None or abs(fitted.offset - line.at(fitted.middle)) > 0.5 * seen.width[k]:
            refused[k] = "its profile is none of a groove"
        else:
            fine[k] = fitted
    _enough(fine, plate, refused)
    usual = max(1.0, float(np.median([line.misfit for line in fine.values()])))
    crossed = {
        k: f"its profile misses the image by {line.misfit:.1f} times the photons' variance, the others by {usual:.1f}"
        for k, line in fine.items()
        if line.misfit > MISFIT * usual
    }
    fine = {k: line for k, line in fine.items() if k not in crossed}
    _enough(fine, plate, refused | crossed)
    bent = refused_lines(fine, plate, detector)
    refused |= crossed | bent
    if len(refused) > MOST_REFUSED * plate.lines:
        raise UnusableInputError(
            f"{len(refused)} of the {plate.lines} lines of the {plate.name} plate are missing or out of place; is it this plate, and where"
            " it should be?"
        )
    fine = {k: line for k, line in fine.items() if k not in bent}
    _enough(fine, plate, refused)
    return _points(fine, plate, refused)


def coarse_points(image: np.ndarray, plate: MarkerPlate, expected: MarkerProjection, detector: Detector) -> CoarsePoints:
    """Run the first four steps alone: hybrid median, Canny, Hough, least squares."""
    counts = _usable(image, detector)
    lines = _coarse_lines(counts, hybrid_median(counts), plate, _Expected.of(plate, expected, detector))
    index, pixels = [], []
    for i in (k for k in lines if k < len(plate.x_m)):
        for j in (k for k in lines if k >= len(plate.x_m)):
            one, other = lines[i], lines[j]
            column = (one.offset + one.slope * other.offset) / (1.0 - one.slope * other.slope)
            index.append(i * len(plate.y_m) + j - len(plate.x_m))
            pixels.append((column, other.at(column)))
    return CoarsePoints(lines, np.array(index, dtype=int), np.array(pixels).reshape(-1, 2))


@dataclass(frozen=True)
class _Expected:
    """Grooves as expected: ends (lines, 2, 2) as (along, across) [pixel] and width [pixel]."""

    ends: np.ndarray
    width: np.ndarray

    @classmethod
    def of(cls, plate: MarkerPlate, expected: MarkerProjection, detector: Detector) -> _Expected:
        count = len(plate.x_m)
        ends_m = plate.ends_m()
        aside = np.zeros((plate.lines, 1, 3))
        aside[:count, 0, 0] = aside[count:, 0, 1] = 0.5 * plate.groove_m
        ends, before, after = (detector.to_pixels(expected.project(points)) for points in (ends_m, ends_m - aside, ends_m + aside))
        across = np.concatenate([(after - before)[:count, :, 0], (after - before)[count:, :, 1]]).mean(axis=1)
        if (across <= 0.0).any():
            raise UnusableInputError("the plate's x and y must run with the image's columns and rows; turn its frame by half a turn")
        ends[:count] = ends[:count, :, ::-1]
        order = np.argsort(ends[:, :, 0], axis=1)
        return cls(np.take_along_axis(ends, order[..., None], axis=1), across)

    def slope(self, k: int) -> float:
        (first, start), (last, end) = self.ends[k]
        return float((end - start) / (last - first))


def _usable(image: np.ndarray, detector: Detector) -> np.ndarray:
    if image.shape != (detector.rows, detector.columns):
        raise UnusableInputError(f"an image of shape {image.shape}; the detector has {detector.rows} rows and {detector.columns} columns")
    full = np.iinfo(image.dtype).max if np.issubdtype(image.dtype, np.integer) else np.inf
    if np.mean(image[::4, ::4] >= full) > 0.05:
        raise UnusableInputError(f"{np.mean(image >= full):.0%} of the pixels are saturated at {full}; expose less")
    if not np.isfinite(image[::4, ::4]).all() or float(np.median(image[::4, ::4])) < 5.0:
        raise UnusableInputError(f"the image is dark (median {np.median(image):g} counts); lines need 5 counts a pixel behind the metal")
    return np.ascontiguousarray(image, dtype=np.float32)


def _coarse_lines(counts: np.ndarray, filtered: np.ndarray, plate: MarkerPlate, seen: _Expected) -> dict[int, CoarseLine]:
    count = len(plate.x_m)
    families = edges_of(filtered, counts)
    found: dict[int, CoarseLine] = {}
    for edges, numbers, shape in zip(families, (range(count), range(count, plate.lines)), (counts.shape, counts.shape[::-1]), strict=True):
        found |= _family(edges, np.array(numbers), shape, seen)
    result = {}
    for k, line in found.items():
        fitted = fit_edges(families[k >= count], line, seen.width[k], _clear(k, line, found, plate, seen, counts.shape))
        if fitted is not None:
            result[k] = fitted
    return result


def _family(edges: Edges, numbers: np.ndarray, shape: tuple[int, int], seen: _Expected) -> dict[int, CoarseLine]:
    """Return Hough's lines of one direction by the plate's numbers."""
    middle = 0.5 * (shape[0] - 1)
    places = np.array([seen.ends[k, 0, 1] + seen.slope(k) * (middle - seen.ends[k, 0, 0]) for k in numbers])
    apart = float(np.diff(np.sort(places)).min())
    inside = np.minimum(seen.ends[numbers, 1, 0], shape[0] - 1) - np.maximum(seen.ends[numbers, 0, 0], 0.0)
    turn = float(np.arctan(np.mean([seen.slope(k) for k in numbers])))
    lines = hough_lines(edges, shape, float(seen.width[numbers].mean()), turn, float(inside.mean()), apart)
    return {int(numbers[k]): line for k, line in matched(lines, places, middle, GATE_SHARE * apart).items()}


def _clear(
    k: int, line: CoarseLine, lines: dict[int, CoarseLine], plate: MarkerPlate, seen: _Expected, shape: tuple[int, int]
) -> np.ndarray:
    """Return which places on line k lie inside the plate and the image, away from every crossing line: (along,) bool."""
    count = len(plate.x_m)
    length = shape[0] if k < count else shape[1]
    along = np.arange(length)
    margin = 0.5 * seen.width[k] + CLEAR_OF_CROSSINGS
    first, last = seen.ends[k, :, 0]
    keep: np.ndarray = (along > max(first + margin, 2.0)) & (along < min(last - margin, length - 3.0))
    for other in range(count, plate.lines) if k < count else range(count):
        if other in lines:
            crossing = float(lines[other].at(line.at(0.5 * length)))
            crossing = float(lines[other].at(line.at(crossing)))
        else:
            crossing = seen.ends[other, 0, 1] + seen.slope(other) * (line.at(0.5 * length) - seen.ends[other, 0, 0])
        keep &= np.abs(along - crossing) > margin
    return keep


def _enough(lines: dict[int, FineLine], plate: MarkerPlate, refused: dict[int, str]) -> None:
    upright = sum(k < len(plate.x_m) for k in lines)
    flat = len(lines) - upright
    if min(upright, flat) < 2 or len(lines) < 5:
        why = "; ".join(f"line {k}: {reason}" for k, reason in sorted(refused.items())[:3])
        raise UnusableInputError(
            f"{upright} of {len(plate.x_m)} lines along y and {flat} of {len(plate.y_m)} along x of the {plate.name} plate are in the"
            f" image; two of each and five in all are needed ({why})"
        )


def _points(lines: dict[int, FineLine], plate: MarkerPlate, refused: dict[int, str]) -> MarkerPoints:
    """Return the crossings, with the covariance of the lines carried over."""
    numbers = sorted(lines)
    column_of = {k: 2 * place for place, k in enumerate(numbers)}
    upright, flat = [k for k in numbers if k < len(plate.x_m)], [k for k in numbers if k >= len(plate.x_m)]
    index, pixels, slopes = [], [], []
    for i in upright:
        for j in flat:
            one, other = lines[i], lines[j]
            # column = a + b (row - p), row = c + d (column - q)
            through = 1.0 - one.slope * other.slope
            column = (one.offset + one.slope * (other.offset - other.slope * other.middle - one.middle)) / through
            row = other.offset + other.slope * (column - other.middle)
            of_one = np.array([1.0, row - one.middle])
            of_other = np.array([1.0, column - other.middle])
            change = np.zeros((2, 2 * len(numbers)))
            change[0, column_of[i] : column_of[i] + 2] = of_one / through
            change[0, column_of[j] : column_of[j] + 2] = one.slope * of_other / through
            change[1, column_of[i] : column_of[i] + 2] = other.slope * of_one / through
            change[1, column_of[j] : column_of[j] + 2] = of_other / through
            index.append(i * len(plate.y_m) + j - len(plate.x_m))
            pixels.append((column, row))
            slopes.append(change)
    of_lines = np.zeros((2 * len(numbers), 2 * len(numbers)))
    for k, place in column_of.items():
        of_lines[place : place + 2, place : place + 2] = lines[k].covariance
    change = np.concatenate(slopes)
    return MarkerPoints(np.array(index), np.array(pixels), change @ of_lines @ change.T, lines, refused)
