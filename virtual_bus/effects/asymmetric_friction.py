"""Friction that differs with the direction of motion."""

from __future__ import annotations

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="asymmetric_friction",
    plain="The joint rubs more one way than the other.",
    kind=FRICTION,
    parameters=(
        Parameter("Fc_plus", unit="Nm", low=0.0, high=2000.0, description="Coulomb level of motion towards positive position"),
        Parameter("Fc_minus", unit="Nm", low=0.0, high=2000.0, description="Coulomb level of motion towards negative position"),
        Parameter("Fv_plus", unit="Nm s/rad", low=0.0, high=1000.0, description="viscous coefficient of motion towards positive position"),
        Parameter("Fv_minus", unit="Nm s/rad", low=0.0, high=1000.0, description="viscous coefficient of motion towards negative position"),
    ),
    equation="(Fc± + Fv± abs(speed)) sign(speed)",
    convention=(
        "effort on the joint = -(Fc_plus + Fv_plus speed) for speed > 0, +(Fc_minus + Fv_minus abs(speed)) for speed < 0, on "
        "the joint's side of the gear; at rest the Coulomb level of the direction it would move in holds"
    ),
    neighbours=("constant_load", "gravity_imbalance", "coulomb_friction"),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, Sec. 2.1",
    family="dry_friction",
    parent="coulomb_friction",
    sought_at=("axis",),
    left_out="at rest it holds, and in motion its level and its slope differ by direction",
)


def level(state: JointState, Fc_plus: float, Fc_minus: float, Fv_plus: float, Fv_minus: float) -> float:
    """Return the friction level [Nm or N] of this direction."""
    return Fc_plus + Fv_plus * state.speed if state.direction > 0.0 else Fc_minus + Fv_minus * state.speed


def laws(place: Place) -> list[Law]:
    """Return levels and slopes of both directions."""
    return [each(("Fc_plus", "Fc_minus", "Fv_plus", "Fv_minus"))]
