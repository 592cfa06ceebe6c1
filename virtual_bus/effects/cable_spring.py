"""Cable spring: hoses and cables that pull harder the further the joint is from their rest position."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.effects.effect import EFFORT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="cable_spring",
    plain="Cables and hoses pull the joint back, harder the further it is from where they hang loose.",
    kind=EFFORT,
    parameters=(
        Parameter("kc", unit="Nm/rad", low=0.0, high=100000.0, description="stiffness"),
        Parameter("kc3", unit="Nm/rad^3", low=0.0, high=1000000.0, description="cubic stiffness"),
        Parameter("theta0", unit="rad", low=-10.0, high=10.0, description="position at which the cable is slack", is_strength=False),
    ),
    equation="kc (position - theta0) + kc3 (position - theta0)^3",
    convention="effort on the joint = -kc (position - theta0) - kc3 (position - theta0)^3, on the joint's side of the gear",
    neighbours=("gravity_imbalance", "transmission_error", "constant_load"),
    source="Noël and Kerschen 2017, Sec. 2.1",
    family="static_load",
)


def effort(motion: JointMotion, kc: float, kc3: float, theta0: float) -> float:
    """Return the effort [Nm or N] on the joint."""
    x = motion.position - theta0
    return -kc * x - kc3 * x * x * x


def laws(place: Place) -> list[Law]:
    """Return a straight line over the position, and a cubic about several positions."""
    ends = (place.low, place.high)
    line = Law(
        tuple({"kc": 1.0, "kc3": 0.0, "theta0": end} for end in ends),
        lambda w: {"kc": max(float(w[0] + w[1]), 0.0), "kc3": 0.0, "theta0": _slack(w, ends)},
        -math.inf,
    )
    cubic = [each(("kc", "kc3"), theta0=place.low + share * place.travel) for share in (0.0, 0.5, 1.0)]
    return [line, *cubic]


def _slack(weights: np.ndarray, ends: tuple[float, float]) -> float:
    """Return where two springs together are slack."""
    total = float(weights[0] + weights[1])
    return min(max((weights[0] * ends[0] + weights[1] * ends[1]) / total, -10.0), 10.0) if total > 0.0 else 0.5 * (ends[0] + ends[1])
