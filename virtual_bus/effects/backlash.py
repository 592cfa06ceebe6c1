"""Backlash: a gap in the gear through which no effort passes, or little where its flanks come into contact gradually."""

from __future__ import annotations

from virtual_bus.effects.effect import ELASTIC, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="backlash",
    plain="There is play in the gear: after a reversal the motor turns a little before the load follows.",
    kind=ELASTIC,
    parameters=(
        Parameter("b", unit="rad", low=0.0, high=0.1, description="half of the gap"),
        Parameter(
            "flank",
            unit="rad",
            low=0.0,
            high=0.1,
            description="deflection over which the flanks come into touch: crowned, rough or with a film between them; 0: at once",
            is_strength=False,
            default=0.0,
        ),
    ),
    equation="K deflection - K b sat(deflection / (b + flank)); flank = 0: K deadzone(deflection, b)",
    convention=(
        "the spring behind the axis pulls with -K (deflection - b) beyond b + flank, +K (-deflection - b) below -(b + flank), between "
        "with flank / (b + flank) of its stiffness: b is half the gap, on the joint's side of the gear; the spring's damper acts throughout"
    ),
    neighbours=("presliding_hysteresis", "joint_compliance", "delay"),
    source="Nordin and Gutman 2002, eq. (3); Johnson 1985, ch. 4 (flanks in contact are softer at first)",
    family="elasticity",
    play="b",
    left_out="the spring is taken in contact: within the gap no effort passes",
)


def effort(motion: JointMotion, b: float, flank: float) -> float:
    """Return the effort [Nm or N] that the gap takes off the spring's pull."""
    if b <= 0.0:
        return 0.0
    return motion.stiffness * min(max(motion.deflection * (b / (b + flank)), -b), b)


def laws(place: Place) -> list[Law]:
    """Return a small gap, closed at once or over several deflections."""
    largest = 0.5 * place.travel
    return [one("b", min(0.02 * largest, 0.1), flank=min(share * largest, 0.1)) for share in (0.0, 0.1, 0.4)]
