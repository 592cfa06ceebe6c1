"""Coulomb friction: an effort that opposes motion and does not depend on its speed."""

from __future__ import annotations

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="coulomb_friction",
    plain="The joint rubs with the same effort at every speed, as dry bearings and seals do.",
    kind=FRICTION,
    parameters=(Parameter("Fc", unit="Nm", low=0.0, high=2000.0, description="friction level, the same at every speed and both ways"),),
    equation="Fc sign(speed)",
    convention="effort on the joint = -Fc sign(speed), on the joint's side of the gear; a joint at rest is held up to Fc",
    neighbours=("viscous_friction", "load_dependent_friction", "torque_constant"),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, eq. (3)",
    family="dry_friction",
    everyday=True,
    sought_at=("axis",),
    left_out="at rest it holds, and in motion it has no slope",
)


def level(state: JointState, Fc: float) -> float:
    """Return the friction level [Nm or N]."""
    return Fc


def laws(place: Place) -> list[Law]:
    """Return one level."""
    return [one("Fc")]
