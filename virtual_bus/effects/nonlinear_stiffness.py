"""Nonlinear stiffness: a drive train that hardens or softens as it winds up."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.effects.effect import ELASTIC, Effect, Parameter
from virtual_bus.effects.motion import JointMotion
from virtual_bus.effects.residual import Residual, fitted

EFFECT = Effect(
    name="nonlinear_stiffness",
    kind=ELASTIC,
    parameters=(
        Parameter("k3", unit="Nm/rad3", low=-10000000000000.0, high=10000000000000.0, description="cubic stiffness; negative softens"),
    ),
    equation="K deflection + k3 deflection^3",
    convention=(
        "effort on the spring behind the axis (or under the body) = -k3 deflection^3 besides its own -K deflection, on the "
        "joint's side of the gear; a negative k3 is limited to the deflection at which the spring would stop growing, sqrt(K / "
        "(3 abs(k3)))"
    ),
    neighbours=("bouc_wen_hysteresis", "backlash"),
    source="Noël and Kerschen 2017, Sec. 2.1",
)


def effort(motion: JointMotion, k3: float) -> float:
    """Effort [Nm or N] on the sprung joint."""
    x = motion.deflection
    if k3 < 0.0:
        knee = math.sqrt(motion.stiffness / (-3.0 * k3))
        x = min(max(x, -knee), knee)
    return -k3 * x * x * x


def guess(residual: Residual) -> tuple[float]:
    """The cubic part of the missing effort over the spring's deflection."""
    x = residual.other_position
    return (float(fitted([-(x**3), -x, np.ones_like(x)], residual.effort)[0]),)
