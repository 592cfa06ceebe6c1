"""Positions and motions as people give them. Inside, everything is in rad and m."""

from __future__ import annotations

import math

EDGES = {"rad": (180.0 / math.pi, "deg"), "m": (1e3, "mm")}
"""Factor and name of the unit in which people give a position."""


def at_the_edge(value: float, unit: str, digits: int = 5) -> str:
    """Return a position or motion in words: in degrees, or in millimetres on a prismatic axis; other units as they are.

    Parameters
    ----------
    value : float
    unit : str
        rad or m, or one of both per time, as in rad/s2.
    digits : int
        Significant ones.
    """
    base, slash, per = unit.partition("/")
    factor, name = EDGES.get(base, (1.0, base))
    return f"{value * factor:.{digits}g} {name}{slash}{per}"
