"""Quadratic friction: an effort against motion that grows with the square of its speed."""

from __future__ import annotations

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="quadratic_friction",
    plain="Friction grows with the square of speed, as the drag of air or oil does.",
    kind=FRICTION,
    parameters=(Parameter("Fv2", unit="Nm s^2/rad^2", low=0.0, high=5000.0, description="effort per squared speed"),),
    equation="Fv2 speed abs(speed)",
    convention="effort on the joint = -Fv2 speed abs(speed), on the joint's side of the gear",
    neighbours=("viscous_friction",),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, Sec. 2.1",
    family="viscous_friction",
    sought_at=("axis",),
    left_out="its slope is nothing at rest and grows with speed",
)


def level(state: JointState, Fv2: float) -> float:
    """Return the friction level [Nm or N]."""
    return Fv2 * state.speed * state.speed


def laws(place: Place) -> list[Law]:
    """Return one coefficient."""
    return [one("Fv2")]
