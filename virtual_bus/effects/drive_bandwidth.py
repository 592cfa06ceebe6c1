"""Drive bandwidth: a current loop that follows its target as a second-order low pass."""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg

from virtual_bus.effects.effect import LAG, Effect, Parameter
from virtual_bus.effects.law import Law, Place

EFFECT = Effect(
    name="drive_bandwidth",
    plain="The drive follows fast changes of its command only in part and late.",
    kind=LAG,
    parameters=(
        Parameter("fc", unit="Hz", low=0.0, high=50000.0, description="natural frequency; 0: at once, no effect"),
        Parameter("zeta", unit="", low=0.2, high=2.0, description="damping ratio", is_strength=False),
    ),
    equation="i'' + 2 zeta wc i' + wc^2 i = wc^2 u",
    convention=(
        "the current follows the applied target through a second-order low pass of unit gain, exact for a target held over a "
        "plant step; the measured current is the low pass's output at the SYNC"
    ),
    neighbours=("delay", "structural_mode", "viscous_friction"),
    source="CiA 402 drives' current loops; closed form by the matrix exponential",
    family="drive_lag",
    is_exact=True,
)


def error_system(fc: float, zeta: float) -> np.ndarray:
    """Return S (2, 2) of the error e = (i - u, i') at a held target, e' = S e; (0, 0) where the current follows at once."""
    w = 2.0 * np.pi * fc
    return np.array([[0.0, 1.0], [-w * w, -2.0 * zeta * w]]) if fc > 0.0 else np.zeros((0, 0))


def transition(step_s: float, fc: float, zeta: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the transition of the error (i - u, i') over a step, and the weights of its mean over the step.

    The transition is (2, 2), the weights are (2,). fc must be positive.
    """
    system = error_system(fc, zeta)
    after = scipy.linalg.expm(system * step_s)
    return after, np.linalg.solve(system, after - np.eye(2))[0] / step_s


def laws(place: Place) -> list[Law]:
    """Return a lag of a tenth of a row, which is in proportion to one over the natural frequency."""
    return [_of_damping(zeta, 10.0 / (2.0 * math.pi * place.period_s)) for zeta in (0.5, 1.0)]


def _of_damping(zeta: float, highest_Hz: float) -> Law:
    """Return the law of a damping ratio, whose weight is a lag."""
    return Law(({"fc": highest_Hz, "zeta": zeta},), lambda w: {"fc": highest_Hz / max(float(w[0]), 1e-3), "zeta": zeta})
