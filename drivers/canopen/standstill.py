"""Since when an axis that is stopped has stood: its motor side has changed no more, or, where that showed no motion, its link."""

from __future__ import annotations

from math import isfinite, nan


class Still:
    """For how many ticks one encoder has stayed within a width of where it was, and whether it ever was elsewhere."""

    def __init__(self, width: float) -> None:
        self._width, self._at, self.ticks, self._since = width, nan, 0, 0
        self.moved = False

    def take(self, position: float, ticks: int) -> None:
        """Take a position, `ticks` after the last; where none has come, NaN, the next one tells whether it stood meanwhile."""
        self._since += ticks
        if abs(position - self._at) <= self._width:
            self.ticks, self._since = self.ticks + self._since, 0
        elif isfinite(position):
            self.moved = self.moved or isfinite(self._at)
            self._at, self.ticks, self._since = position, 0, 0


class Standstill:
    """When the stop of an axis brought it to stand.

    Parameters
    ----------
    flicker, swing : float
        Of a motor side, and of a link, that stand [rad or m].
    moved : float
        Of a motor side that has moved again [rad or m]: its brake let it slip.
    period_s : float
        Between ticks.

    Attributes
    ----------
    stood_s : float
        From the beginning of the stop until its position changed no more, 0 where no encoder has left `flicker` or `swing`; NaN where it
        has not been seen to stand, or moves again. A structure may swing on behind a motor side that was seen to come to rest.
    """

    def __init__(self, flicker: float, swing: float, moved: float, period_s: float) -> None:
        self.motor, self.link = Still(flicker), Still(swing)
        self._moved, self._swing, self._period_s = moved, swing, period_s
        self._ticks, self._at, self.stood_s = 0, (nan, nan), nan

    def take(self, motor: float, link: float, ticks: int) -> None:
        """Take both positions, `ticks` after the last, NaN where none has come."""
        self._ticks += ticks
        self.motor.take(motor, ticks)
        self.link.take(link, ticks)

    def note(self, motor: float, link: float, seen: tuple[bool, bool], *, stands: bool) -> None:
        """Note whether it stands at what was taken last, by which of its encoders are seen."""
        if abs(motor - self._at[0]) > self._moved or abs(link - self._at[1]) > self._swing:
            self.stood_s, self._at = nan, (nan, nan)
        if stands and not isfinite(self.stood_s):
            sides = [side for side, is_seen in zip((self.motor, self.link), seen, strict=True) if is_seen]
            still = self.motor.ticks if seen[0] and self.motor.moved else min(side.ticks for side in sides)
            showed = self.motor.moved or self.link.moved
            self.stood_s, self._at = max(self._ticks - still, 0) * self._period_s if showed else 0.0, (motor, link)
