"""The newest positions of one encoder: how far it swings, and whether it has left its swing of before."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import inf, isfinite, nan


class EncoderPath:
    """The newest positions of one encoder."""

    def __init__(self, window: int) -> None:
        self._positions: deque[float] = deque(maxlen=window)
        self._stale = 0
        self._low = self._high = nan

    def take(self, position: float) -> None:
        """Take a position; NaN when none has come."""
        if isfinite(position):
            self._positions.append(position)
            self._stale = 0
        else:
            self._stale += 1

    def fresh(self, stale_ticks: int) -> bool:
        """Return whether a position has come, and lately."""
        return bool(self._positions) and self._stale <= stale_ticks

    @property
    def range(self) -> float:
        """Width of the newest positions; endless where there are none."""
        return max(self._positions) - min(self._positions) if self._positions else inf

    def mark(self) -> None:
        """Remember the range of its swing, where a position has come."""
        self._low, self._high = min(self._positions, default=nan), max(self._positions, default=nan)

    def beyond(self) -> float:
        """Return how far its newest position is outside the marked range; 0 inside, and where nothing was marked."""
        position = self._positions[-1]
        return position - self._high if position > self._high else position - self._low if position < self._low else 0.0


def slipped(moved: Mapping[str, float], travel: float, apart: float, unit: str) -> str:
    """Return which side of an axis shows that its brake slips, and how far, in words; '' where none does.

    A brake that slips moves both sides alike. One side alone may swing, or wind up the gear, by as much as a standing axis may.

    Parameters
    ----------
    moved : mapping of str to float
        How far each side that is seen is beyond its swing of before.
    travel, apart : float
        By which both may have moved, and one alone.
    unit : str
    """
    for name, beyond in moved.items():
        if all(beyond * other > 0.0 and abs(other) > travel for other in moved.values()):
            return f"its brake slips: {name} moved by {beyond:+.1e} {unit}"
        if abs(beyond) > max(travel, apart):
            return f"{name} alone moved by {beyond:+.1e} {unit}"
    return ""
