"""Power-law friction: lubricated contacts, whose friction grows with speed less and less."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointState

CREEP = 1e-3
"""rad/s or m/s: slower, a film is thick against its changes and viscous; a power of speed alone would have no slope at rest."""

EFFECT = Effect(
    name="power_law_friction",
    plain="Grease drags: friction grows with speed, at first steeply and then less and less.",
    kind=FRICTION,
    parameters=(
        Parameter("F1", unit="Nm", low=0.0, high=5000.0, description="effort at a speed of one: 1 rad/s or 1 m/s"),
        Parameter(
            "p",
            unit="",
            low=0.3,
            high=0.8,
            description="exponent: 1/2, the square root of speed, of fits to robots; 2/3 of rolling bearings with oil",
            is_strength=False,
            default=0.5,
        ),
    ),
    equation="F1 speed (speed^2 + (0.001 rad/s)^2)^((p - 1) / 2)",
    convention=(
        "effort on the joint = -F1 abs(speed)^p sign(speed), speed in rad/s (m/s), on the joint's side of the gear; a joint that creeps, "
        "slower than 1 mrad/s (1 mm/s), has a viscous film, and at rest nothing holds it"
    ),
    neighbours=("viscous_friction", "coulomb_friction", "stribeck_friction"),
    source="Harris and Kotzalas 2006, ch. 10 (after Palmgren 1959: (viscosity x speed)^(2/3)); square root: an intermediate exponent",
    family="viscous_friction",
    parent="viscous_friction",
    sought_at=("axis",),
    left_out="its slope at rest holds below 1 mrad/s (1 mm/s) alone",
)


def level(state: JointState, F1: float, p: float) -> float:
    """Return the friction level [Nm or N]."""
    effort: float = F1 * state.speed * math.hypot(state.speed, CREEP) ** (p - 1.0)
    return effort


def laws(place: Place) -> list[Law]:
    """Return one strength, at the square root of speed."""
    return [one("F1", p=0.5)]
