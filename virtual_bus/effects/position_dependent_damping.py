"""Position-dependent damping: an effort in proportion to speed, by a coefficient that varies along the joint's travel."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import EFFORT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each, wave
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="position_dependent_damping",
    plain="Moving fast is harder at some positions than at others, as where grease has gathered or a guide is tight.",
    kind=EFFORT,
    parameters=(
        Parameter(
            "D1", unit="Nm s/rad^2", low=-1000.0, high=1000.0, description="growth of the coefficient with the position", default=0.0
        ),
        Parameter("D2", unit="Nm s/rad^3", low=-1000.0, high=1000.0, description="growth with the square of the position", default=0.0),
        Parameter("A", unit="Nm s/rad", low=0.0, high=1000.0, description="amplitude of a wave of the coefficient", default=0.0),
        Parameter(
            "k",
            unit="cycles/turn",
            low=0.1,
            high=100000.0,
            description="its periods per turn of the joint (a prismatic joint: radians per metre)",
            is_strength=False,
            default=1.0,
        ),
        Parameter(
            "phi",
            unit="phase",
            low=-6.283185307179586,
            high=6.283185307179586,
            description="its phase: the coefficient is largest where k position + phi = 0",
            is_strength=False,
            default=0.0,
        ),
    ),
    equation="(D1 position + D2 position^2 + A cos(k position + phi)) speed",
    convention=(
        "effort on the joint = minus that, on the joint's side of the gear, in addition to the joint's own damping and viscous_friction, "
        "with which it should not be negative: a negative coefficient drives"
    ),
    neighbours=("viscous_friction", "position_dependent_friction", "load_dependent_friction"),
    source="Taylor series and Fourier's first term of a viscous coefficient over the position",
    family="viscous_friction",
    parent="viscous_friction",
    sought_at=(),
)


def effort(motion: JointMotion, D1: float, D2: float, A: float, k: float, phi: float) -> float:
    """Return the effort [Nm or N] on the joint."""
    x = motion.position
    return -(D1 * x + D2 * x * x + A * math.cos(k * x + phi)) * motion.speed


def laws(place: Place) -> list[Law]:
    """Return a parabola, and periods per turn from what the range shows up to some ten."""
    parabola = each(("D1", "D2"), both_signs=True, A=0.0, k=1.0, phi=0.0)
    return [parabola, *(wave("A", "phi", D1=0.0, D2=0.0, k=k) for k in (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 18.0))]
