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
from hil.imaging.markers.groove_shape import shape_of
from hil.imaging.markers.pieces import FADE, REACH, SIZE, Pieces, Profiles, fit_pieces, profiles, split, together
from hil.imaging.markers.plane import CUT, Plane
from hil.imaging.markers.plates import MarkerPlate
from hil.imaging.markers.projection import MarkerProjection
from hil.imaging.markers.windows import WIDEST_TURN, Window, look

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

CENTRED = 0.015
"""Where the plate is within this of the profiles' middles, in grooves' widths, they are centred."""

MOST_REFUSED = 1.0 / 3.0
"""With a larger share of the lines missing or out of place it is unknown which of the others are right."""


Shapes = tuple[tuple[float, float], tuple[float, float]]
"""Of the grooves along y and of those along x: width as a share of the drawing's, and blur [pixel]."""


@dataclass(frozen=True)
class Start:
    """What one image tells of the next: where the plate is, and its grooves' shapes."""

    plane: Plane
    shapes: Shapes


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
    start : Start, optional
        Where the next image's grooves are looked for.
    """

    index: np.ndarray
    pixels: np.ndarray
    covariance: np.ndarray
    lines: dict[int, FineLine]
    refused: dict[int, str]
    spoilt: float = 0.0
    start: Start | None = None


def find_marker(
    image: np.ndarray, plate: MarkerPlate, expected: MarkerProjection, detector: Detector, before: MarkerPoints | None = None
) -> MarkerPoints:
    """Find a plate's crossings.

    Parameters
    ----------
    image : (rows, columns) array
        Photon counts; grooves are brighter than the plate.
    plate : MarkerPlate
    expected : MarkerProjection
        Where it should be, to less than half the distance of two grooves and 6 degrees.
    detector : Detector
    before : MarkerPoints, optional
        What the image before showed, of the same plate, looked for in the same place. Grooves are then fitted where it had them. Where one
        is lost or found again, or the plate has moved by more than a window's error, the image is looked at as if it were the first.

    Raises
    ------
    UnusableInputError
        The image is none of this detector, is dark or saturated, or shows too little of the plate.
    """
    upright = usable(image, detector)
    counts = upright, np.ascontiguousarray(upright.T)
    seen = Expected.of(plate, expected, detector)
    if before is not None and (points := _followed(counts, plate, seen, before)) is not None:
        return points
    plane = _looked_for(counts, plate, seen, detector)
    rough = [(1.0, FIRST_BLUR * float(seen.width[list(seen.family(k))].mean())) for k in (0, seen.upright)]
    shapes = rough[0], rough[1]
    _Fitted.of(_Gathered.of(counts, plane, seen), shapes, plane)
    return _Fitted.of(_Gathered.of(counts, plane, seen), shapes, plane).shaped().points(plate)  # again, centred on the grooves


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


def _followed(counts: Both, plate: MarkerPlate, seen: Expected, before: MarkerPoints) -> MarkerPoints | None:
    """Return the crossings by a fit about the grooves of the image before, and another about those it finds where they have moved.

    None where they are elsewhere, or others than these.
    """
    if before.start is None:
        return None
    plane, shapes = before.start.plane.copy(), before.start.shapes
    lines, ends = np.arange(plate.lines), seen.ends[:, :, 0].T
    for _ in range(2):
        about = plane.copy()
        fitted = _Fitted.of(_Gathered.of(counts, about, seen), shapes, plane)
        moved = np.array([plane.across(lines, along) - about.across(lines, along) for along in ends])
        if (np.abs(moved) < CENTRED * seen.width).all():
            break
        if not (np.abs(moved) < WINDOW_SIGMA * seen.width).all():
            return None
    else:
        return None
    if not _in_reach(plane, seen):
        return None
    try:
        points = fitted.shaped().points(plate)
    except UnusableInputError:
        return None
    return points if points.refused.keys() == before.refused.keys() else None


def _in_reach(plane: Plane, seen: Expected) -> bool:
    """Tell whether the plate is where the windows would find it: beyond, a groove is mistaken for the next."""
    for first in (0, seen.upright):
        lines = np.array(seen.family(first))
        last = float(seen.length(first) - 1)
        offset, slope = (each[lines] for each in seen.drawn)
        begin, end = (plane.across(lines, np.full(len(lines), at)) - offset - slope * at for at in (0.0, last))
        shift, turn = 0.5 * float(np.median(begin + end)), float(np.median(end - begin)) / last
        if not (abs(shift) < GATE_SHARE * seen.apart(first) and abs(turn) < WIDEST_TURN):
            return False
    return True


def _values(line: CoarseLine) -> tuple[float, float]:
    return line.offset, line.slope


@dataclass(frozen=True)
class _Gathered:
    """Profiles about where a plane puts the grooves: the groove of each piece, its width by the drawing, and the profiles by direction."""

    line: np.ndarray
    width: np.ndarray
    sides: tuple[Profiles, ...]

    @classmethod
    def of(cls, counts: Both, plane: Plane, seen: Expected) -> _Gathered:
        """Gather them from an image."""
        numbers = np.arange(len(seen.width))
        last = np.array([seen.length(k) - 1.0 for k in range(len(numbers))])
        start, end = plane.across(numbers, np.zeros(len(numbers))), plane.across(numbers, last)
        slope, cuts = (
            (end - start) / last,
            np.isfinite(start) & np.isfinite(end),
        )  # a plane fitted to another plate may cut a groove's image nowhere
        sides, line = [], []
        for first in (0, seen.upright):
            family = list(seen.family(first))
            reach = REACH * float(seen.width[family].mean())
            profiled = [Profiles.none(reach)]
            for k in family:
                if not cuts[k]:
                    continue
                share = seen.clear(k, start, slope)
                if (piece := split(share, PIECE * seen.width[k])).max() >= 0:
                    profiled.append(profiles(counts[first > 0], float(start[k]), float(slope[k]), piece, reach, share, fade=FADE))
                    line.append(np.full(len(profiled[-1].along), k))
            sides.append(together(profiled))
        which = np.concatenate([np.zeros(0, dtype=int), *line])
        return cls(which, seen.width[which], tuple(sides))

    def by_direction(self, each: np.ndarray) -> list[np.ndarray]:
        """Return a value of each piece, parted by direction."""
        return np.split(each, [len(self.sides[0].along)])


@dataclass(frozen=True)
class _Fitted:
    """All pieces: fitted, their deviations [pixel], which are good, and what they miss the plane by."""

    gathered: _Gathered
    sides: tuple[Pieces, ...]
    start: Start
    along: np.ndarray
    across: np.ndarray
    sigma: np.ndarray
    good: np.ndarray
    rest: np.ndarray

    @classmethod
    def of(cls, gathered: _Gathered, shapes: Shapes, plane: Plane, before: tuple[Pieces | None, ...] = (None, None)) -> _Fitted:
        """Fit the pieces, from what they were before where that is told, and the plane to them."""
        line, widths = gathered.line, gathered.by_direction(gathered.width)
        sides = tuple(
            fit_pieces(side, share * width, blur, start)
            for side, width, (share, blur), start in zip(gathered.sides, widths, shapes, before, strict=True)
        )
        along, across, variance, misfit, sigma = (
            np.concatenate([getattr(side, name) for side in sides]) for name in ("along", "across", "variance", "misfit", "contrast_sigma")
        )
        contrast = np.concatenate([side.values[:, 1] for side in sides])
        shown = np.isfinite(variance) & (contrast > CLEAREST * sigma)
        good, rest, deviation = np.zeros(len(line), dtype=bool), np.full(len(line), np.inf), np.full(len(line), 1.0)
        if shown.sum() >= 5 * FEWEST_PIECES:
            clearness = (contrast[shown] / sigma[shown]) ** 2
            shape_error = max(0.0, float(np.median((misfit[shown] - 1.0) / clearness)))
            ratio = misfit[shown] / (1.0 + shape_error * clearness)
            freedom = np.concatenate([np.count_nonzero(side.number, axis=1) - SIZE for side in gathered.sides])[shown]
            deviation[shown] = np.sqrt(variance[shown] * beyond_chance(ratio, freedom))
            shown[shown] = (ratio < MISFIT) & (contrast[shown] > FAINTEST * float(np.median(contrast[shown])))
        if shown.sum() >= 5 * FEWEST_PIECES:
            rest[shown], further = plane.fitted(line[shown], along[shown], across[shown], deviation[shown])
            deviation = np.hypot(deviation, further)
            good = np.abs(rest) < CUT * deviation
        return cls(gathered, sides, Start(plane, shapes), along, across, deviation, good, rest)

    def shaped(self) -> _Fitted:
        """Return the fit with the shapes that the good pieces show: those of this image, whatever they were before."""
        widths, good = self.gathered.by_direction(self.gathered.width), self.gathered.by_direction(self.good)
        first, other = (shape_of(*each) for each in zip(self.gathered.sides, self.sides, good, widths, self.start.shapes, strict=True))
        return _Fitted.of(self.gathered, (first, other), self.start.plane, self.sides)

    def points(self, plate: MarkerPlate) -> MarkerPoints:
        """Return the crossings of the lines that can be used; UnusableInputError where these are too few."""
        lines, refused = {}, {}
        for k in range(plate.lines):
            there = slice(*np.searchsorted(self.gathered.line, [k, k + 1]))
            if reason := self._trouble(there):
                refused[k] = reason
                continue
            good = np.flatnonzero(self.good[there]) + there.start
            share, blur = self.start.shapes[k >= len(plate.x_m)]
            shape = share * float(self.gathered.width[there.start]), blur
            lines[k] = line_through(self.along[good], self.across[good], self.sigma[good], shape)
        _enough(lines, plate, refused)
        return _points(widened(lines, self.start.plane), plate, refused, 1.0 - float(np.mean(self.good)), self.start)

    def _trouble(self, there: slice) -> str:
        """Return why the line of these pieces cannot be used; empty if it can."""
        good, rest = self.good[there], self.rest[there]
        if not len(good):
            return "not in the image"
        shown, enough = np.isfinite(rest), max(FEWEST_PIECES, LEAST_GOOD * len(good))
        if good.sum() >= enough:
            return ""
        if shown.sum() < enough:
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


def _points(lines: dict[int, FineLine], plate: MarkerPlate, refused: dict[int, str], spoilt: float, start: Start) -> MarkerPoints:
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
    index, pixels = i * len(plate.y_m) + j - len(plate.x_m), np.stack([column, row], axis=1)
    return MarkerPoints(index, pixels, of_points, lines, refused, spoilt, start)
