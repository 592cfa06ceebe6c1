"""What a chart shows: series, bands and marks over one abscissa. Drawn in the page by charts.js, as a still picture by still.py."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

COLOURS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Black and Okabe and Ito's palette: told apart by colour-blind readers."""

DASHES: tuple[tuple[int, ...], ...] = ((), (9, 4), (2, 3), (9, 3, 2, 3), (14, 4), (5, 2))
"""On and off [px], beside the colours: told apart in grey. One fewer than colours, so that look 7 is black and dashed."""

MARKERS = ("circle", "cross", "square", "triangle", "plus", "diamond", "ring")
"""Shapes of points, beside the colours."""


@dataclass(frozen=True)
class Scale:
    """An axis of a chart: its label with the unit in brackets, logarithmic or not, and, where they are fixed, its ends."""

    label: str
    is_log: bool = False
    ends: tuple[float, float] | None = None


class Style(NamedTuple):
    """How a series is drawn: colour, dashes of a line [px], marker of points."""

    colour: str
    dash: tuple[int, ...]
    marker: str


@dataclass(frozen=True, eq=False)
class Series:
    """A curve or a cloud of points.

    Parameters
    ----------
    label : str
        In the legend.
    x, y : ndarray, shape (N,)
        x finite and, for a line, not decreasing; y NaN where there is nothing. Series with the same x share one array.
    is_points : bool
        Points that no line joins.
    look : int, optional
        Colour with its dashes or marker, by number; that of the place in the chart unless given.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    is_points: bool = False
    look: int | None = None

    def __post_init__(self) -> None:
        """Check the shapes, and bring points into the order of x."""
        _check(self.label, self.x, self.y)
        if self.is_points:
            order = np.argsort(self.x, kind="stable")
            object.__setattr__(self, "x", np.asarray(self.x)[order])
            object.__setattr__(self, "y", np.asarray(self.y)[order])
        elif (np.diff(self.x) < 0.0).any():
            raise ValueError(f"{self.label}: x decreases; a line goes along x")


@dataclass(frozen=True, eq=False)
class Band:
    """An area between `low` and `high` (N,) over x (N,)."""

    label: str
    x: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def __post_init__(self) -> None:
        """Check the shapes."""
        _check(self.label, self.x, self.low, self.high)


@dataclass(frozen=True)
class Mark:
    """A place on the abscissa with what is there, such as a mode with frequency and damping."""

    x: float
    label: str


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart.

    Parameters
    ----------
    title : str
    x, y : Scale
    series : sequence of Series
    bands, marks : sequences, optional
    pose : str, optional
        Where the machine stood, where that matters.
    note : str, optional
        A sentence below.
    group : str, optional
        Charts of one group share zoom along x and cursor; "" for none.
    height : int
        Of the drawing [px].
    """

    title: str
    x: Scale
    y: Scale
    series: Sequence[Series]
    bands: Sequence[Band] = ()
    marks: Sequence[Mark] = ()
    pose: str = ""
    note: str = ""
    group: str = ""
    height: int = 220

    def looks(self) -> list[int]:
        """Return the look of each series: its own, or the next that is free."""
        taken = {one.look for one in self.series if one.look is not None}
        free = (look for look in itertools.count() if look not in taken)
        return [next(free) if one.look is None else one.look for one in self.series]

    def styles(self) -> list[Style]:
        """Return how each series is drawn; a curve that is alone needs no dashes."""
        alone = len(self.series) == 1
        return [
            Style(
                COLOURS[look % len(COLOURS)],
                () if alone or one.is_points else DASHES[look % len(DASHES)],
                MARKERS[look % len(MARKERS)] if one.is_points else "",
            )
            for one, look in zip(self.series, self.looks(), strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Charts:
    """Charts side by side in so many columns, below each other on a narrow screen; charts of one cell stand directly above each other."""

    cells: Sequence[Chart | Sequence[Chart]]
    columns: int = 1

    def stacks(self) -> list[tuple[Chart, ...]]:
        """Return the cells, each a tuple."""
        return [(cell,) if isinstance(cell, Chart) else tuple(cell) for cell in self.cells]


def _check(label: str, x: np.ndarray, *others: np.ndarray) -> None:
    if np.ndim(x) != 1 or any(np.shape(other) != np.shape(x) for other in others):
        raise ValueError(f"{label}: shapes {', '.join(str(np.shape(one)) for one in (x, *others))}; all (N,) would be right")
    if not np.isfinite(x).all():
        raise ValueError(f"{label}: x is not finite")


def means_along(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the means of points (N,) in steps along x that hold about as many points each as there are steps."""
    steps = np.array_split(np.argsort(x, kind="stable"), max(1, int(np.sqrt(len(x)))))
    return np.array([x[step].mean() for step in steps]), np.array([y[step].mean() for step in steps])
