"""Nonlinear stiffness: a drive train that hardens or softens as it winds up."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import ELASTIC, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="nonlinear_stiffness",
    kind=ELASTIC,
    parameters=(
        Parameter("k3", unit="Nm/rad^3", low=-1e18, high=1e18, description="cubic stiffness; negative softens"),
        Parameter(
            "bend",
            unit="1/rad^2",
            low=0.0,
            high=1000000000000.0,
            description="one over the square of the deflection about which the cubic becomes a straight line; 0: nowhere",
            is_strength=False,
            default=0.0,
        ),
        Parameter(
            "corner",
            unit="rad",
            low=0.0,
            high=0.1,
            description="deflection from which on the spring hardens or softens, where what is wound up comes into touch",
            is_strength=False,
            default=0.0,
        ),
    ),
    equation=(
        "K deflection + 3 k3 / bend (x - tanh(r x) / r), r = sqrt(bend), x = deflection beyond +-corner, 0 within; "
        "bend = 0: K deflection + k3 x^3"
    ),
    convention=(
        "effort on the spring behind the axis (or under the body) = minus what comes besides its own -K deflection, on the joint's side of "
        "the gear; nothing within the corner; far beyond corner + 1 / sqrt(bend) the spring is K + 3 k3 / bend stiff; a negative k3 is "
        "limited to the x at which the spring would stop growing, with bend = 0 sqrt(K / (3 abs(k3)))"
    ),
    neighbours=("bouc_wen_hysteresis", "backlash"),
    source="Noël and Kerschen 2017, Sec. 2.1; Shaw and Holmes 1983 (a spring that another comes to at a corner)",
    family="elasticity",
)

NEARLY_CUBIC = 0.01
"""Share of 1 / sqrt(bend) below which the law is taken from its series, where a difference of nearly equal numbers loses its digits."""

FIRST_BEND = 9.0
"""First guess of `bend`, times the square of the largest deflection: from there a fit reaches both a cubic and a corner."""


def effort(motion: JointMotion, k3: float, bend: float, corner: float) -> float:
    """Return the effort [Nm or N] on the sprung joint."""
    x, r = motion.deflection - min(max(motion.deflection, -corner), corner), math.sqrt(bend)
    if k3 < 0.0:
        straight = math.sqrt(motion.stiffness / (-3.0 * k3))  # tanh(r knee) / r
        if r * straight < 1.0:
            knee = math.atanh(r * straight) / r if r * straight > NEARLY_CUBIC * NEARLY_CUBIC else straight
            x = min(max(x, -knee), knee)
    u = r * x
    if abs(u) < NEARLY_CUBIC:
        return -k3 * x * x * x * (1.0 - 0.4 * u * u)
    return -3.0 * k3 / bend * (x - math.tanh(u) / r)


def laws(place: Place) -> list[Law]:
    """Return a cubic, straight or from a corner on."""
    largest = 0.5 * place.travel
    k3 = 0.1 * place.stiffness / largest**2
    return [one("k3", k3, both_signs=True, bend=bend, corner=0.0) for bend in (0.0, 9.0 / largest**2)]
