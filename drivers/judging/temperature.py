"""Is a thermometer to be believed, and the winding not too hot: limit, rate of change, broken wire."""

from __future__ import annotations

from math import isfinite, nan

import numpy as np
from numba.extending import register_jitable

from drivers.interface import Sample
from drivers.judging.settings import TemperatureJudging
from drivers.records import Record, record_type

WINDOW_S = 10.0
"""Time over which a change is judged: some steps of a thermometer of a tenth of a kelvin under full load."""

STEPS = 3.0
"""Steps of its resolution by which a sound thermometer flickers: one either way, and one of rounding on the wire."""

CHECKS = ("", "broken", "limit", "rate")
_FINE, _BROKEN, _LIMIT, _RATE = range(4)

THERMOMETER = record_type(
    ("axis", "i8"),
    ("limit_degC", "f8"),
    ("rate_K_s", "f8"),
    ("step_K", "f8"),
    ("io_stale_s", "f8"),
    ("period_s", "f8"),
    ("window", "i8"),  # ticks
    # what was seen
    ("reference", "f8"),  # degC, at the start of the window
    ("newest", "f8"),
    ("ticks", "i8"),  # of the window, so far
)
"""Settings and memory of a thermometer's judge."""


@register_jitable
def judged_temperature(thermometer: Record, newest: float, io_age_s: float, ticks: int) -> int:
    """Return which of `CHECKS` a temperature [degC] fails, 0 when none; callable from compiled code.

    Parameters
    ----------
    thermometer : THERMOMETER
        Advanced in place.
    newest, io_age_s : float
        Temperature and age of the I/O's state.
    ticks : int
        Passed since the sample before.
    """
    if io_age_s > thermometer.io_stale_s:  # the I/O is silent, which is no fault of the thermometer
        return _FINE
    thermometer.newest = newest
    if not isfinite(newest):
        return _BROKEN
    if newest > thermometer.limit_degC:
        return _LIMIT
    thermometer.ticks += ticks
    allowed = thermometer.rate_K_s * thermometer.ticks * thermometer.period_s + STEPS * thermometer.step_K
    found = _RATE if abs(newest - thermometer.reference) > allowed else _FINE
    if thermometer.ticks >= thermometer.window or not isfinite(thermometer.reference):
        thermometer.reference, thermometer.ticks = newest, 0
    return found


class TemperatureJudge:
    """Judges the thermometer of one axis.

    Parameters
    ----------
    settings : TemperatureJudging
    state : (1,) array of THERMOMETER, optional
        Its memory.

    Attributes
    ----------
    lag_ticks : int
        For how many ticks before the newest one the readings are in doubt too: none.
    """

    checks = CHECKS
    lag_ticks = 0

    def __init__(self, settings: TemperatureJudging, state: np.ndarray | None = None) -> None:
        self.sensor, self.follows = settings.sensor, settings.follows
        self._settings = settings
        self._state = (np.zeros(1, THERMOMETER) if state is None else state)[0]
        self.begin()

    def begin(self) -> None:
        """Begin anew: no temperature is known."""
        state, settings = self._state, self._settings
        state.axis, state.limit_degC, state.rate_K_s, state.step_K = settings.axis, settings.limit_degC, settings.rate_K_s, settings.step_K
        state.io_stale_s, state.period_s, state.window = settings.io_stale_s, settings.period_s, round(WINDOW_S / settings.period_s)
        state.reference = state.newest = nan
        state.ticks = 0

    def step(self, sample: Sample, ticks: int) -> str:
        """Return which check the newest sample fails, '' when none; `ticks` passed since the one before."""
        return CHECKS[judged_temperature(self._state, sample.temperature_degC[self._settings.axis], sample.io_age_s, ticks)]

    def says(self, check: str) -> str:
        """Return a failed check in words."""
        settings, newest = self._settings, float(self._state.newest)
        if check == "broken":
            return "reads no temperature: its wire is broken, or it is not connected"
        if check == "limit":
            return f"{newest:.1f} degC, {settings.limit_degC:.1f} are allowed"
        change = newest - float(self._state.reference)
        return f"{change:+.1f} K within {WINDOW_S:g} s; a winding changes by at most {settings.rate_K_s:.2g} K/s"
