"""Load-dependent friction: gear friction in proportion to the effort the joint carries."""

from __future__ import annotations

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="load_dependent_friction",
    plain="The joint rubs the more, the more it has to carry.",
    kind=FRICTION,
    parameters=(Parameter("Kl", unit="", low=0.0, high=0.5, description="friction per effort carried"),),
    equation="Kl abs(load) sign(speed)",
    convention=(
        "effort on the joint = -Kl abs(load) sign(speed); load is the effort that gravity, velocities and added efforts ask of "
        "the joint at constant speed, on the joint's side of the gear; a joint at rest is held up to that level"
    ),
    neighbours=("position_dependent_friction", "gravity_imbalance", "coulomb_friction"),
    source="Bittencourt and Gunnarsson 2012, eq. (5)",
    family="dry_friction",
    sought_at=("axis",),
    left_out="at rest it holds, and in motion it changes sign with the direction",
)


def level(state: JointState, Kl: float) -> float:
    """Return the friction level [Nm or N]."""
    return Kl * abs(state.load)


def laws(place: Place) -> list[Law]:
    """Return one coefficient."""
    return [one("Kl", 0.1)]
