"""Thresholds from a stated chance of a false alarm: how often a sound sensor may be found wrong."""

from __future__ import annotations

import math
from statistics import NormalDist

WIRE_RESOLUTION = 2.0**-20
"""Smallest step of a reading on the wire: of the format with 20 fractional bits, and of a 32-bit float near 10 m/s^2."""


def share_of(probability_per_hour: float, trials_per_s: float) -> float:
    """Return the chance that each of so many trials a second may have, for this chance in an hour."""
    return probability_per_hour / (3600.0 * trials_per_s)


def packets_until_frozen(noise_rms: float, resolution: float, chance: float, at_least: int) -> int:
    """Return how many equal readings in a row noise makes less likely than `chance`; 0 where there is no noise to tell.

    Two readings fall into one step of the resolution q only if their noise, normal with deviation s, differs by less than q. The
    difference is normal with deviation s sqrt(2), so the chance is at most erf(q / 2 s).
    """
    if noise_rms <= 0.0:
        return 0
    equal = math.erf(max(resolution, WIRE_RESOLUTION) / (2.0 * noise_rms))
    if equal >= 1.0:
        return 0
    return max(at_least, 1 + math.ceil(math.log(chance) / math.log(equal)))


def deviations(chance: float) -> float:
    """Return by how many standard deviations a normal value exceeds its mean, either way, with this chance."""
    return -NormalDist().inv_cdf(chance / 2.0)
