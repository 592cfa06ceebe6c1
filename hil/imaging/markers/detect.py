"""A marker plate in an X-ray image: its lines and their crossings to a small fraction of a pixel (thesis Sec. 6.3.3).

With a patient in the beam, too: lines are fitted to short pieces of the grooves, and the pieces that the anatomy spoils are out of line
with what all others say of a flat plate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.markers.expected import LEAST_IN_VIEW, CoarseLine, Expected, usable
from hil.imaging.markers.fine_lines import FineLine, beyond_chance, line_through, widened
from hil.imaging.markers.pieces import REACH, SIZE, Pieces, Profiles, fit_pieces, profiles, shape_of, split
from hil.imaging.markers.plane import CUT, Plane
from hil.imaging.markers.plates import MarkerPlate
from hil.imaging.markers.projection import MarkerProjection
from hil.imaging.markers.windows import Window, look

GATE_SHARE = 0.45
"""All lines together may be off by this share of their least distance; beyond, one is mistaken for the next."""

FIRST_BLUR = 0.18
"""Where the fit of the blur starts, in widths of a groove."""

WINDOW_SIGMA = 0.25
"""Deviation of a line's place from its window, in widths of a groove: half a step of the search."""

PIECE = 1.5
"""Length of a piece in widths of a groove: about as long as what crosses a groove is wide."""

MISFIT = 4.0
"""A piece whose profile misses the image by this factor more than its photons and the profile's usual error say is crossed. Not an
absolute bound: the focal spot is no Gaussian, and the more photons, the more of that shows."""

CLEAREST = 3.0
"""A piece's contrast is above this many of its deviations, or it shows no groove."""

FAINTEST = 0.35
"""A piece's contrast is above this share of the median: the plate's grooves are all of one depth."""

FEWEST_PIECES, LEAST_GOOD = 3, 0.25
"""A line with fewer pieces, or a smaller share of its pieces, in line with the plate is refused."""

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
    spoilt : float
        Share of the grooves' pieces that were not used.
    """

    index: np.ndarray
    pixels: np.ndarray
    covariance: np.ndarray
    lines: dict[int, FineLine]
    refused: dict[int, str]
    spoilt: float = 0.0


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
    upright = usable(image, detector)
    counts = upright, np.ascontiguousarray(upright.T)
    seen = Expected.of(plate, expected, detector)
    plane = _looked_for(counts, plate, seen, detector)
    shapes = {k: (float(seen.width[k]), FIRST_BLUR * float(seen.width[k])) for k in range(plate.lines)}
    gathered = _gathered(counts, plane, seen)
    rough = _Fitted.of(gathered, shapes, plane, seen)
    for k, pieces in rough.pieces.items():
        shapes[k] = shape_of(gathered[k], pieces, rough.good[k], *shapes[k])
    gathered = _gathered(counts, plane, seen)  # again, centred on the grooves
    fitted = _Fitted.of(gathered, shapes, plane, seen)
    lines, refused = {}, {k: "not in the image" for k in range(plate.lines) if k not in fitted.pieces}
    for k, pieces in fitted.pieces.items():
        if reason := fitted.trouble(k):
            refused[k] = reason
        else:
            lines[k] = line_through(pieces, fitted.good[k], fitted.sigma[k], shapes[k])
    _enough(lines, plate, refused)
    return _points(widened(lines, plane), plate, refused, 1.0 - float(np.mean(np.concatenate(list(fitted.good.values())))))


Both = tuple[np.ndarray, np.ndarray]
"""An image (along, across) for the grooves along y, and turned over for those along x."""


def _looked_for(counts: Both, plate: MarkerPlate, seen: Expected, detector: Detector) -> Plane:
    """Return the plane as windows about the expected grooves show it."""
    which, along, across = [], [], []
    for first in (0, seen.upright):
        inside = {k: seen.inside(k) for k in seen.family(first)}
        windows = [Window(k, *_values(seen.line(k)), keep) for k, keep in inside.items() if keep.sum() >= LEAST_IN_VIEW]
        if not windows:
            continue
        width = float(np.mean(seen.width[list(inside)]))
        for k, (offset, slope) in look(counts[first > 0], windows, width, GATE_SHARE * seen.apart(first)).items():
            ends = np.flatnonzero(inside[k])[[0, -1]]
            which += [k, k]
            along += list(ends)
            across += list(offset + slope * ends)
    if len({k for k in which if k < seen.upright}) < 2 or len({k for k in which if k >= seen.upright}) < 2:
        _enough({}, plate, {})
    places = np.array(which), np.array(along, dtype=float), np.array(across)
    plane = Plane(plate, detector).started(*places)
    plane.fitted(*places, WINDOW_SIGMA * seen.width[places[0]])
    return plane


def _values(line: CoarseLine) -> tuple[float, float]:
    return line.offset, line.slope


def _gathered(counts: Both, plane: Plane, seen: Expected) -> dict[int, Profiles]:
    """Return the profiles of every line that has pieces, about where the plane puts it."""
    lines = {}
    for k in range(len(seen.width)):
        first, last = 0.0, float(seen.length(k) - 1)
        start, end = plane.across(np.array([k, k]), np.array([first, last]))
        if np.isfinite([start, end]).all():  # a plane that was fitted to another plate may cut a groove's image nowhere
            lines[k] = CoarseLine(float(start), float((end - start) / (last - first)))
    result = {}
    for k, line in lines.items():
        piece = split(seen.clear(k, lines), PIECE * seen.width[k])
        if piece.max() >= 0:
            result[k] = profiles(counts[k >= seen.upright], line.offset, line.slope, piece, REACH * seen.width[k])
    return result


@dataclass(frozen=True)
class _Fitted:
    """Pieces by line: fitted, their deviations [pixel], which are good, and what they miss the plane by."""

    pieces: dict[int, Pieces]
    sigma: dict[int, np.ndarray]
    good: dict[int, np.ndarray]
    rest: dict[int, np.ndarray]

    @classmethod
    def of(cls, gathered: dict[int, Profiles], shapes: dict[int, tuple[float, float]], plane: Plane, seen: Expected) -> _Fitted:
        """Fit the pieces, and the plane to them."""
        pieces = {k: fit_pieces(each, *shapes[k]) for k, each in gathered.items()}
        sizes = [len(each.along) for each in pieces.values()]
        line = np.repeat(np.array(list(pieces), dtype=int), sizes)
        along, across, variance, misfit, sigma = (
            np.concatenate([np.zeros(0), *(getattr(each, name) for each in pieces.values())])
            for name in ("along", "across", "variance", "misfit", "contrast_sigma")
        )
        contrast = np.concatenate([np.zeros(0), *(each.values[:, 1] for each in pieces.values())])
        shown = np.isfinite(variance) & (contrast > CLEAREST * sigma)
        good, rest, deviation = np.zeros(len(line), dtype=bool), np.full(len(line), np.inf), np.full(len(line), 1.0)
        if shown.sum() >= 5 * FEWEST_PIECES:
            clearness = (contrast[shown] / sigma[shown]) ** 2
            shape_error = max(0.0, float(np.median((misfit[shown] - 1.0) / clearness)))
            ratio = misfit[shown] / (1.0 + shape_error * clearness)
            freedom = np.concatenate([np.count_nonzero(each.number, axis=1) - SIZE for each in gathered.values()])[shown]
            deviation[shown] = np.sqrt(variance[shown] * beyond_chance(ratio, freedom))
            shown[shown] = (ratio < MISFIT) & (contrast[shown] > FAINTEST * float(np.median(contrast[shown])))
        if shown.sum() >= 5 * FEWEST_PIECES:
            rest[shown], further = plane.fitted(line[shown], along[shown], across[shown], deviation[shown])
            deviation = np.hypot(deviation, further)
            good = np.abs(rest) < CUT * deviation
        cuts = np.cumsum(sizes)[:-1]
        parts = (dict(zip(pieces, np.split(each, cuts), strict=True)) for each in (deviation, good, rest))
        return cls(pieces, *parts)

    def trouble(self, k: int) -> str:
        """Return why line k cannot be used; empty if it can."""
        good, rest = self.good[k], self.rest[k]
        shown = np.isfinite(rest)
        if good.sum() >= max(FEWEST_PIECES, LEAST_GOOD * len(good)):
            return ""
        if shown.sum() < max(FEWEST_PIECES, LEAST_GOOD * len(good)):
            return f"{shown.sum()} of its {len(good)} pieces show a groove"
        if good.any():
            return f"{good.sum()} of its {len(good)} pieces are where the other lines put it"
        return f"{abs(np.median(rest[shown])):.2f} pixels from where the other lines put it"


def _enough(lines: dict[int, FineLine], plate: MarkerPlate, refused: dict[int, str]) -> None:
    upright = sum(k < len(plate.x_m) for k in lines)
    flat = len(lines) - upright
    if min(upright, flat) < 2 or len(lines) < 5:
        why = "; ".join(f"line {k}: {reason}" for k, reason in sorted(refused.items())[:3])
        raise UnusableInputError(
            f"{upright} of {len(plate.x_m)} lines along y and {flat} of {len(plate.y_m)} along x of the {plate.name} plate are in the"
            f" image; two of each and five in all are needed{f' ({why})' if why else ''}"
        )
    if len(refused) > MOST_REFUSED * plate.lines:
        raise UnusableInputError(
            f"{len(refused)} of the {plate.lines} lines of the {plate.name} plate are missing or out of place; compare plate, place and"
            " directions with the machine file"
        )


def _points(lines: dict[int, FineLine], plate: MarkerPlate, refused: dict[int, str], spoilt: float) -> MarkerPoints:
    """Return the crossings, with the covariance of the lines carried over."""
    numbers = sorted(lines)
    upright, flat = (np.array([k for k in numbers if (k < len(plate.x_m)) == first]) for first in (True, False))
    i, j = np.repeat(upright, len(flat)), np.tile(flat, len(upright))
    offset, slope, middle = np.zeros((3, plate.lines))
    for k, line in lines.items():
        offset[k], slope[k], middle[k] = line.offset, line.slope, line.middle
    # column = offset_i + slope_i (row - middle_i), row = offset_j + slope_j (column - middle_j)
    through = 1.0 - slope[i] * slope[j]
    column = (offset[i] + slope[i] * (offset[j] - slope[j] * middle[j] - middle[i])) / through
    row = offset[j] + slope[j] * (column - middle[j])
    of_one = np.stack([np.ones(len(i)), row - middle[i]], axis=1) / through[:, None]
    of_other = np.stack([np.ones(len(j)), column - middle[j]], axis=1) / through[:, None]
    change = np.zeros((len(i), 2, plate.lines, 2))
    points = np.arange(len(i))
    change[points, 0, i], change[points, 0, j] = of_one, slope[i, None] * of_other
    change[points, 1, i], change[points, 1, j] = slope[j, None] * of_one, of_other
    covariance = np.zeros((plate.lines, 2, plate.lines, 2))
    for k, line in lines.items():
        covariance[k, :, k] = line.covariance
    by_lines = change.reshape(2 * len(i), -1)
    of_points = by_lines @ covariance.reshape(2 * plate.lines, -1) @ by_lines.T
    return MarkerPoints(i * len(plate.y_m) + j - len(plate.x_m), np.stack([column, row], axis=1), of_points, lines, refused, spoilt)
