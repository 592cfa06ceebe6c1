"""What is left above the noise for certain."""

from __future__ import annotations

import math

STILL_SIGNIFICANT = 0.08
STILL_SIGNIFICANT_DEVIATIONS = 7.0
"""Excess of |residual|^2 over its noise, as a share of the noise and in the standard deviations of so many independent entries, from which
what is left is above the noise for certain. The noise of three or four repeats is known no better, least where it comes at reversals or in
a narrow band: beside the truth's own noise-free answers |residual|^2 of 114 benchmark cases came out at 0.89 to 1.16 of it, of one of them
beyond this and of three beyond 0.05 and four deviations."""


def certain_excess(noise: float) -> float:
    """Of |residual|^2 over its expectation, from which what is left is above the noise for certain."""
    return max(STILL_SIGNIFICANT * noise, STILL_SIGNIFICANT_DEVIATIONS * math.sqrt(2.0 * noise))
