"""Backlash: a gap in the gear through which no effort passes."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.effect import ELASTIC, Effect, Parameter
from virtual_bus.effects.motion import JointMotion
from virtual_bus.effects.residual import Residual

EFFECT = Effect(
    name="backlash",
    kind=ELASTIC,
    parameters=(
        Parameter("b", unit="rad", low=0.0, high=0.1, description="half of the gap"),
    ),
    equation="K deadzone(deflection, b)",
    convention=(
        "the spring behind the axis pulls with -K (deflection - b) beyond +b, +K (-deflection - b) below -b, nothing between: b "
        "is half the gap, on the joint's side of the gear; the spring's damper acts throughout"
    ),
    neighbours=("presliding_hysteresis", "joint_compliance", "delay"),
    source="Nordin and Gutman 2002, eq. (3)",
)


def effort(motion: JointMotion, b: float) -> float:
    """What the gap takes off the spring's pull [Nm or N]."""
    return motion.stiffness * min(max(motion.deflection, -b), b)


def guess(residual: Residual) -> tuple[float]:
    """A gap as wide as the missing effort over the spring's stiffness."""
    return (0.5 * float(np.ptp(residual.effort)) / max(residual.stiffness, 1e-9),)
