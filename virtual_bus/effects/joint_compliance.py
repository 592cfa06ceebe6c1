"""Joint compliance: a drive train softer than the machine file says."""

from __future__ import annotations

from virtual_bus.effects.effect import SPRING_CHANGE, Effect, Parameter
from virtual_bus.effects.law import Law, Place

EFFECT = Effect(
    name="joint_compliance",
    plain="Shaft or gear is softer than expected: the load lags behind the motor when it is pushed.",
    kind=SPRING_CHANGE,
    parameters=(
        Parameter("c", unit="rad/Nm", low=0.0, high=0.001, description="compliance in series with the spring behind the axis"),
        Parameter("d", unit="Nm s/rad", low=0.0, high=10000.0, description="damping added to the spring's"),
    ),
    equation="tau = (deflection - rest) / (1/K + c) + d deflection'",
    convention=(
        "the spring behind the axis (or under the body) becomes 1 / (1/K + c) and its damper grows by d, on the joint's side of "
        "the gear; structural_mode where the machine file has no spring there"
    ),
    neighbours=("backlash", "structural_mode", "nonlinear_stiffness"),
    source="Spong 1987, eqs. (13)-(14)",
    family="elasticity",
    is_exact=True,
)


def _stiffness(value: float, c: float, d: float) -> float:
    return value / (1.0 + c * value)


def _damping(value: float, c: float, d: float) -> float:
    return value + d


CHANGES = (("joint", "stiffness", _stiffness), ("joint", "damping", _damping))


def laws(place: Place) -> list[Law]:
    """Return a tenth of the spring's own compliance, and damping beside."""
    c = min(0.1 / max(place.stiffness, 1e-9), 0.001)
    return [Law(({"c": c, "d": 0.0}, {"c": 0.0, "d": 1.0}), lambda w: {"c": c * float(w[0]), "d": float(w[1])})]
