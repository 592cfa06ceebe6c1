"""Where a plate's grooves are expected in an image, and which places along them can be relied on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.markers.plates import MarkerPlate
from hil.imaging.markers.projection import MarkerProjection
from hil.imaging.pixels import check_exposed, counted

CLEAR_OF_CROSSINGS = 0.7
"""Beyond half a groove this far, in grooves' widths, from a crossing line's middle and from a line's end, scatter and blur have rounded
the corners."""

BORDER = 2.5
"""Of the image [pixel]: a pixel is compared with two to either side."""

LEAST_IN_VIEW = 30
"""A groove with fewer places inside plate and image [pixel] is not looked for."""


@dataclass(frozen=True)
class CoarseLine:
    """across = offset + slope * along [pixel]."""

    offset: float
    slope: float

    def at(self, along: np.ndarray | float) -> np.ndarray | float:
        """Return where the line is."""
        return self.offset + self.slope * along


@dataclass(frozen=True)
class Expected:
    """Grooves as expected: ends (lines, 2, 2) as (along, across) [pixel] and width [pixel]; those along y come first.

    Attributes
    ----------
    ends, width : arrays
    upright : int
        How many of them run along y.
    shape : (rows, columns)
        Of the image.
    """

    ends: np.ndarray
    width: np.ndarray
    upright: int
    shape: tuple[int, int]

    @classmethod
    def of(cls, plate: MarkerPlate, expected: MarkerProjection, detector: Detector) -> Expected:
        """Project the plate's drawing.

        Raises
        ------
        UnusableInputError
            The plate's axes run against the image's.
        """
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
        return cls(np.take_along_axis(ends, order[..., None], axis=1), across, count, (detector.rows, detector.columns))

    @cached_property
    def drawn(self) -> tuple[np.ndarray, np.ndarray]:
        """Offsets and slopes of the lines, (lines,) each."""
        first, last = self.ends[:, 0], self.ends[:, 1]
        slope = (last[:, 1] - first[:, 1]) / (last[:, 0] - first[:, 0])
        return first[:, 1] - slope * first[:, 0], slope

    def slope(self, k: int) -> float:
        """Return the slope of line k."""
        return float(self.drawn[1][k])

    def line(self, k: int) -> CoarseLine:
        """Return line k."""
        offset, slope = self.drawn
        return CoarseLine(float(offset[k]), float(slope[k]))

    def length(self, k: int) -> int:
        """Return the size of the image along line k [pixel]."""
        return self.shape[0] if k < self.upright else self.shape[1]

    def family(self, k: int) -> range:
        """Return the numbers of the lines that run as line k does."""
        return range(self.upright) if k < self.upright else range(self.upright, len(self.width))

    def apart(self, k: int) -> float:
        """Return the least distance of two lines of line k's family in the middle of the image [pixel]."""
        middle = 0.5 * (self.length(k) - 1)
        return float(np.diff(np.sort([self.line(each).at(middle) for each in self.family(k)])).min())

    def inside(self, k: int) -> np.ndarray:
        """Return which places on line k lie inside plate and image, away from its ends: (along,) bool."""
        along = np.arange(self.length(k))
        margin = (0.5 + CLEAR_OF_CROSSINGS) * self.width[k]
        first, last = self.ends[k, :, 0]
        keep: np.ndarray = (along > max(first + margin, 2.0)) & (along < min(last - margin, len(along) - 3.0))
        return keep

    def clear(self, k: int, offset: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Return which share (along,) of each place on line k lies on the plate and in the image, away from its ends and crossing lines.

        Lines are as found, across = offset + slope * along; where these are no numbers, as expected. The ends move with the crossing lines.
        """
        others = slice(self.upright, None) if k < self.upright else slice(self.upright)
        expected = _crossed(self.line(k), self.drawn[0][others], self.drawn[1][others])
        there = _crossed(CoarseLine(offset[k], slope[k]), offset[others], slope[others])
        there = np.where(np.isfinite(offset[others]) & np.isfinite(slope[others]), there, expected)
        ends = self.ends[k, :, 0]
        moved = there - expected
        ends = ends + moved[0] + (ends - expected[0]) * (moved[-1] - moved[0]) / (expected[-1] - expected[0])
        margin, own = (0.5 + CLEAR_OF_CROSSINGS) * self.width[others], (0.5 + CLEAR_OF_CROSSINGS) * self.width[k]
        last = float(self.length(k) - 1)
        begin, end = max(ends[0] + own, BORDER), min(ends[1] - own, last - BORDER)
        first, beyond = np.concatenate([there - margin, [-1.0, end]]), np.concatenate([there + margin, [begin, last + 1.0]])
        return _without(self.length(k), first, beyond)


def _crossed(line: CoarseLine, offset: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return where along a line others cross it."""
    with np.errstate(invalid="ignore"):
        places: np.ndarray = (offset + slope * line.offset) / (1.0 - slope * line.slope)
    return places


@njit(cache=True)
def _without(count: int, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the share (count,) of each place that is in none of the intervals; place k reaches from k - 1/2 to k + 1/2."""
    share = np.ones(count)
    for k in range(len(first)):
        for place in range(max(0, int(np.rint(max(first[k], -1.0)))), min(count, int(np.rint(min(last[k], count))) + 1)):
            share[place] *= 1.0 - min(max(min(place + 0.5, last[k]) - max(place - 0.5, first[k]), 0.0), 1.0)
    return share


def usable(image: np.ndarray, detector: Detector) -> np.ndarray:
    """Return the image as `counted` does.

    Raises
    ------
    UnusableInputError
        It is none of this detector, is dark, or saturated.
    """
    if image.shape != (detector.rows, detector.columns):
        raise UnusableInputError(f"an image of shape {image.shape}; the detector has {detector.rows} rows and {detector.columns} columns")
    check_exposed(image, 5.0, "lines need 5 counts a pixel behind the metal")
    return counted(image)
