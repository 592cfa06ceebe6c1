"""Plants of Chapter 7's examples, written down from the thesis and its corrections."""

from __future__ import annotations

import numpy as np

from controllers.shapers.dynamics import Dynamics

NATURAL, DAMPING = np.sqrt(2.0), 0.02

CORRECTED_FREQUENCIES = np.array([np.sqrt(2.0), 2.5, 3.0])
CORRECTED_DAMPINGS = np.array([0.002, 0.005, 0.003])
ALPHA, BETA = 5e-4, 1.7
TABLE_7_2 = np.array([0.2016, -0.1748, 0.3767, -0.4864, 0.4687, -0.6266, 0.3840, -0.5129, 0.2381, -0.1873, 0.0992, 1.0076])
FORCING_7_2 = (0.7, 1.7, 2.2)


def example_7_1() -> Dynamics:
    """(7.15)."""
    return Dynamics.from_polynomials([NATURAL**2], [1.0, 2.0 * DAMPING * NATURAL, NATURAL**2])


def sixth_order() -> tuple[Dynamics, Dynamics]:
    """(7.39) with the corrected numbers, and its tail 1 / [w1^2 w2^2 w3^2 (s^2 + alpha s + beta)]."""
    gain = np.prod(CORRECTED_FREQUENCIES**2)
    denominator = np.ones(1)
    for w, zeta in zip(CORRECTED_FREQUENCIES, CORRECTED_DAMPINGS, strict=True):
        denominator = np.polymul(denominator, [1.0, 2.0 * zeta * w, w**2])
    zeros = np.array([1.0, ALPHA, BETA])
    return Dynamics.from_polynomials(gain * zeros, denominator), Dynamics.from_polynomials([1.0], gain * zeros)
