"""The time of a machine, which all its devices share, and when something is due in one of them."""

from __future__ import annotations

import math

ROUNDING_S = 1e-6
"""Everything is due a microsecond early, so that rounding does not decide whether a time that falls on a sample is due there."""


class Clock:
    """Time as the devices see it.

    Attributes
    ----------
    now_s : float
        The present time.
    due_s : float
        Nothing is due in any device before; something may be due then. Whoever ticks the devices sets it anew; a device that stands alone
        does without.
    """

    __slots__ = ("due_s", "now_s")

    def __init__(self) -> None:
        self.now_s = 0.0
        self.due_s = -math.inf
