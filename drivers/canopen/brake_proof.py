"""The push that proves a brake: its drive lets go, pushes the way the load pulls, and lets go; whether it did is what it measures."""

from __future__ import annotations

from math import copysign, isfinite, nan

PUSH_SHARE = 0.25
"""Share of the load, beyond the load itself, that a proven brake holds: linings wear, and the next load may be a patient's."""
RAMP_S = 0.1  # in which the drive lets go, and in which it pushes: slower than the structure swings
GIVEN_SHARE = 0.5
"""Share of the push that a drive must have measured, where it measures: its answer comes two ticks late, its sensor is off by a tenth.

It counts from no effort, so that letting go late is no push, or from what the sensor is off by the way of the push."""


class BrakePush:
    """One push against a closed brake.

    Parameters
    ----------
    first_move : float
        Effort with which the first move pushes [the drive's unit].
    held : float
        With which the drive holds the axis.
    rated : float
        Of the drive, for messages.
    """

    def __init__(self, first_move: float, held: float, rated: float) -> None:
        self._held, self._rated = held, rated
        self._push = -copysign(first_move + PUSH_SHARE * abs(held), held)
        self._began = self._most = nan  # measured along the push: where nothing was asked, and the most since

    def effort(self, time_s: float) -> float:
        """Return the effort after so long."""
        elapsed = time_s / RAMP_S
        if elapsed <= 1.0:
            return self._held * (1.0 - elapsed)
        return self._push * (elapsed - 1.0 if elapsed <= 2.0 else max(0.0, 3.0 - elapsed))

    @staticmethod
    def is_over(time_s: float) -> bool:
        """Return whether it has ended after so long."""
        return time_s > 3.0 * RAMP_S

    def take(self, time_s: float, measured: float) -> None:
        """Take what the drive measures after so long; NaN where nothing came."""
        if isfinite(measured) and time_s >= RAMP_S:
            along = copysign(1.0, self._push) * measured
            self._began = self._began if isfinite(self._began) else along
            self._most = max(along, self._most) if isfinite(self._most) else along

    @property
    def not_given(self) -> str:
        """What shows that the drive has not pushed, in words; '' where it has, or measures nothing."""
        gave, asked = self._most - max(self._began, 0.0), abs(self._push)
        if not gave < GIVEN_SHARE * asked:
            return ""
        return f"its drive gave {gave / self._rated:.1%} of its rated effort where {asked / self._rated:.1%} were asked"
