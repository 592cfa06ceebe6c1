"""Shared motor friction: a motor that turns with two axes, as in a robot's wrist, and rubs against both."""

from __future__ import annotations

from virtual_bus.effects.effect import SHARED_FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="shared_motor_friction",
    plain="One motor turns with two axes, as in a robot's wrist, and rubs against the motion of both.",
    kind=SHARED_FRICTION,
    parameters=(
        Parameter("Fc", unit="Nm", low=0.0, high=2000.0, description="Coulomb level, on the next axis"),
        Parameter("Fv", unit="Nm s/rad", low=0.0, high=1000.0, description="viscous coefficient, on the next axis"),
        Parameter(
            "c",
            unit="",
            low=-2.0,
            high=2.0,
            description="how much the next axis's motor turns with this axis, over how much with its own; 1 or -1 in a bevel wrist",
            is_strength=False,
            default=1.0,
        ),
    ),
    equation="F = (Fc + Fv abs(w)) sign(w), w = speed2 + c speed1: F on the next axis, c F on this one",
    convention=(
        "the motor of the next axis (2; the first axis after the last) turns with speed2 + c speed1 of the joints; effort on axis 2 = -F, "
        "on this axis (1) = -c F, on the joints' side of the gears; at rest both are held up to that level"
    ),
    neighbours=("coulomb_friction", "viscous_friction", "axis_coupling"),
    source="Gautier, Vandanjon, Presse 1994 (coupled wrist axes: friction of q5 + q6); principle of virtual work",
    family="shared_friction",
    left_out="its constant level holds at rest, and in motion it has no slope",
    left_out_of=("Fc",),
)


def level(state: JointState, Fc: float, Fv: float, c: float) -> float:
    """Return the friction level [Nm or N] against the motor's motion."""
    return Fc + Fv * state.speed


def share(Fc: float, Fv: float, c: float) -> float:
    """Return how much the motor turns with the axis where the effect is, over how much with the next one."""
    return c


def laws(place: Place) -> list[Law]:
    """Return level and slope, of a motor that turns with the sum and with the difference of both axes."""
    return [each(("Fc", "Fv"), c=c) for c in (1.0, -1.0)]
