"""Motor-load friction: what a gear loses of its motor's effort, whatever the load asks for."""

from __future__ import annotations

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="motor_load_friction",
    plain="The gear swallows a share of what the motor gives.",
    kind=FRICTION,
    parameters=(Parameter("Km", unit="", low=0.0, high=0.9, description="friction per effort of the motor"),),
    equation="Km abs(motor) sign(speed)",
    convention=(
        "effort on the joint = -Km abs(motor) sign(speed); motor is the drive's effort less the joint's damper, which holds a back-EMF, "
        "on the joint's side of the gear, and at a joint without drive its spring's effort in place of the drive's; a joint at rest is "
        "held up to that level. A gear that drives its load has the efficiency 1 - Km, one that its load drives 1 / (1 + Km)"
    ),
    neighbours=("load_dependent_friction", "torque_constant", "coulomb_friction"),
    source="Duclusaud, Passault, Padois, Ly 2024 (arXiv:2410.08650), model M5: the part of the motor's torque",
    family="dry_friction",
    sought_at=("axis",),
    left_out="at rest it holds, and in motion it changes sign with the direction",
)


def level(state: JointState, Km: float) -> float:
    """Return the friction level [Nm or N]."""
    return Km * abs(state.motor)


def laws(place: Place) -> list[Law]:
    """Return one coefficient."""
    return [one("Km", 0.1)]
