"""Is a thermometer to be believed, and the winding not too hot: limit, rate of change, broken wire."""

from __future__ import annotations

from math import isfinite, nan

from drivers.interface import Sample
from drivers.judging.settings import TemperatureJudging

WINDOW_S = 10.0
"""Time over which a change is judged: some steps of a thermometer of a tenth of a kelvin under full load."""

STEPS = 3.0
"""Steps of its resolution by which a sound thermometer flickers: one either way, and one of rounding on the wire."""


class TemperatureJudge:
    """Judges the thermometer of one axis.

    Parameters
    ----------
    settings : TemperatureJudging

    Attributes
    ----------
    lag_ticks : int
        For how many ticks before the newest one the readings are in doubt too: none.
    """

    lag_ticks = 0

    def __init__(self, settings: TemperatureJudging) -> None:
        self.sensor, self.follows = settings.sensor, settings.follows
        self._settings = settings
        self._window = round(WINDOW_S / settings.period_s)
        self.begin()

    def begin(self) -> None:
        """Begin anew: no temperature is known."""
        self._reference = self._newest = nan
        self._ticks = 0

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        settings = self._settings
        if sample.io_age_s > settings.io_stale_s:  # the I/O is silent, which is no fault of the thermometer
            return ""
        self._newest = newest = float(sample.temperature_degC[settings.axis])
        if not isfinite(newest):
            return "broken"
        if newest > settings.limit_degC:
            return "limit"
        self._ticks += ticks
        allowed = settings.rate_K_s * self._ticks * settings.period_s + STEPS * settings.step_K
        found = "rate" if abs(newest - self._reference) > allowed else ""
        if self._ticks >= self._window or not isfinite(self._reference):
            self._reference, self._ticks = newest, 0
        return found

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        settings = self._settings
        if check == "broken":
            return "reads no temperature: its wire is broken, or it is not connected"
        if check == "limit":
            return f"{self._newest:.1f} degC, {settings.limit_degC:.1f} are allowed"
        return f"{self._newest - self._reference:+.1f} K within {WINDOW_S:g} s; a winding changes by at most {settings.rate_K_s:.2g} K/s"
