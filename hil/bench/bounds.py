"""The bounds of the sample loop itself: how long a position may be missing, an axis's range, and how far it may be from its reference."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

import numpy as np
from numba import boolean, float64, int64, types, uint8
from numba.extending import register_jitable

from controllers.compiled import kept_on_disk
from controllers.settings import AxisLimits
from drivers.interface import Sample
from drivers.records import Record, record_type
from drivers.sample_memory import values_in

CHECKS = ("", "stale", "range", "tracking error")
_FINE, _STALE, _RANGE, _ERROR = range(4)

BOUND = record_type(
    ("stale_ticks", "i8"),
    ("lower", "f8"),
    ("upper", "f8"),
    ("tracking_error", "f8"),
    # what was seen
    ("stale", "i8"),  # ticks without a position in which somebody answered
)
"""Bounds of one axis."""


@register_jitable
def _exceeded(bound: Record, position: float, wanted: float, is_unanswered: bool) -> int:
    """Return which of `CHECKS` an axis fails, 0 when none."""
    if bound.stale > bound.stale_ticks:
        return _STALE
    if position != position or is_unanswered:  # missing from the first tick, or not known now: the command stays
        return _FINE
    if not bound.lower <= position <= bound.upper:
        return _RANGE
    return _FINE if abs(wanted - position) <= bound.tracking_error else _ERROR


def seen(block: np.ndarray, newest: np.ndarray, sample: np.ndarray, reference: np.ndarray, is_unanswered: bool) -> int:
    """Take over the positions that have arrived, count the ticks without one, and check the newest of every axis.

    Parameters
    ----------
    block : array of bytes
        A BOUND of each axis.
    newest : (axes,) array
        Positions [rad or m]; both are advanced in place.
    sample : array of bytes
        Memory of a `Sample`.
    reference : (axes,) array
        Where the axes should be [rad or m].
    is_unanswered : bool
        Whether the whole bus is late; no axis is silent then.

    Returns
    -------
    int
        The first axis that is out of bounds times the number of `CHECKS`, plus which of these it fails; 0 when none.
    """
    values, bounds = values_in(sample), block.view(BOUND)
    for axis in range(len(bounds)):
        position = values[axis].position
        if position == position:
            newest[axis] = position
            bounds[axis].stale = 0
        elif not is_unanswered:
            bounds[axis].stale = 1 if values[axis].position_late else bounds[axis].stale + 1
    for axis in range(len(bounds)):
        found = _exceeded(bounds[axis], newest[axis], reference[axis], is_unanswered)
        if found != _FINE:
            return axis * len(CHECKS) + found
    return _FINE


_READ = types.Array(float64, 1, "A", readonly=True)
_SEEN = int64(uint8[::1], float64[::1], uint8[::1], _READ, boolean)
_seen_at_once = kept_on_disk(_SEEN, fastmath=False, error_model="numpy")(seen)


class Bounds:
    """The newest position of every axis within its bounds.

    Parameters
    ----------
    limits : sequence of AxisLimits
        In axis order.
    stale_ticks : int
        Ticks in a row without a position that are bridged.

    Attributes
    ----------
    position : (n_axes,) array
        Newest of each axis [rad or m]; NaN before the first.
    """

    def __init__(self, limits: Sequence[AxisLimits], stale_ticks: int) -> None:
        self._limits = tuple(limits)
        self.position = np.full(len(limits), nan)
        self._bounds = np.array([(stale_ticks, each.lower, each.upper, each.tracking_error, 0) for each in limits], BOUND)
        self._block = self._bounds.view(np.uint8)

    def see(self, sample: Sample, reference: np.ndarray) -> int:
        """Take over the positions of a sample; return what is out of bounds, 0 when nothing is."""
        if sample.axes != len(self._limits):
            raise ValueError(f"a sample of {sample.axes} axes and limits of {len(self._limits)}")
        return _seen_at_once(self._block, self.position, sample.memory, reference, sample.unanswered > 0)

    def says(self, found: int, reference: np.ndarray) -> str:
        """Return in words what `see` has found."""
        axis, check = divmod(found, len(CHECKS))
        limit, position, bound = self._limits[axis], float(self.position[axis]), self._bounds[axis]
        if check == _STALE:
            return f"{limit.axis}: no position for {bound.stale} ticks, timing.stale_ticks bridges {bound.stale_ticks}"
        if check == _RANGE:
            return f"{limit.axis}: position {position:.4f} {limit.unit} is outside {limit.lower:.4f} to {limit.upper:.4f} {limit.unit}"
        error = abs(float(reference[axis]) - position)
        return f"{limit.axis}: tracking error {error:.4f} {limit.unit} exceeds {limit.tracking_error:.4f} {limit.unit}"
