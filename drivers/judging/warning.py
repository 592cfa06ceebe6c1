"""Does a drive warn: bit 7 of its statusword (CiA 402), set while it runs at the edge of what it can do."""

from __future__ import annotations

from drivers.canopen.cia402 import WARNING
from drivers.interface import Sample
from drivers.judging.settings import WarningJudging


class WarningJudge:
    """Judges the warning bit of one axis's drive.

    Parameters
    ----------
    settings : WarningJudging

    Attributes
    ----------
    lag_ticks : int
        For how many ticks before the newest one the readings are in doubt too: none.
    """

    lag_ticks = 0

    def __init__(self, settings: WarningJudging) -> None:
        self.sensor, self.follows = settings.sensor, settings.follows
        self._axis = settings.axis
        self._statusword = 0

    def begin(self) -> None:
        """Begin anew; there is nothing to forget."""

    def step(self, sample: Sample, ticks: int) -> str:
        """Return 'warning' while the newest statusword has the bit, '' otherwise."""
        statusword = int(sample.statusword[self._axis])
        if statusword < 0 or not statusword & WARNING:
            return ""
        self._statusword = statusword
        return "warning"

    def says(self, check: str) -> str:
        """Return the warning in words."""
        return f"its drive warns (statusword {self._statusword:04X}h)"
