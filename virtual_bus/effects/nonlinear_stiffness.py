"""Nonlinear stiffness: a drive train that hardens or softens as it winds up, both ways alike or not."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import ELASTIC, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="nonlinear_stiffness",
    plain="Shaft or gear becomes stiffer or softer the further it is twisted, perhaps more one way than the other.",
    kind=ELASTIC,
    parameters=(
        Parameter("k3", unit="Nm/rad^3", low=-1e18, high=1e18, description="cubic stiffness; negative softens"),
        Parameter(
            "bend",
            unit="1/rad^2",
            low=0.0,
            high=1000000000000.0,
            description="one over the square of the deflection about which cubic and square become straight lines; 0: nowhere",
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
        Parameter(
            "k2",
            unit="Nm/rad^2",
            low=-1e12,
            high=1e12,
            description="quadratic stiffness: harder one way, softer the other",
            default=0.0,
            sought=(0.0, 0.0),
        ),
    ),
    equation=(
        "K deflection + 2 k2 / bend log(cosh(r x)) + 3 k3 / bend (x - tanh(r x) / r), r = sqrt(bend), x = deflection beyond +-corner, "
        "0 within; bend = 0: K deflection + k2 x^2 + k3 x^3"
    ),
    convention=(
        "effort on the spring behind the axis (or under the body) = minus what comes besides its own -K deflection, on the joint's side of "
        "the gear; nothing within the corner; far beyond corner + 1 / sqrt(bend) it is K +- 2 k2 / sqrt(bend) + 3 k3 / bend stiff; what "
        "softens it is limited to the x at which the spring would stop growing, with bend = 0 and k2 = 0 sqrt(K / (3 abs(k3)))"
    ),
    neighbours=("bouc_wen_hysteresis", "backlash"),
    source="Noël and Kerschen 2017, Sec. 2.1; Shaw and Holmes 1983 (a spring that another comes to at a corner)",
    family="elasticity",
)

NEARLY_CUBIC = 0.01
"""Share of 1 / sqrt(bend) below which the law is taken from its series, where a difference of nearly equal numbers loses its digits."""

FIRST_BEND = 9.0
"""First guess of `bend`, times the square of the largest deflection: from there a fit reaches both a cubic and a corner."""


def effort(motion: JointMotion, k3: float, bend: float, corner: float, k2: float) -> float:
    """Return the effort [Nm or N] on the sprung joint."""
    x, r = motion.deflection - min(max(motion.deflection, -corner), corner), math.sqrt(bend)
    # with s = tanh(r x) / r the spring's slope is K + 2 k2 s + 3 k3 s^2: it stops growing at a root, K / (-k2 +- root)
    under = k2 * k2 - 3.0 * k3 * motion.stiffness
    if under >= 0.0:
        root = math.sqrt(under)
        for below in (root - k2, -root - k2):
            if below != 0.0:
                straight = motion.stiffness / below
                share = r * abs(straight)
                if share < 1.0:
                    knee = math.atanh(r * straight) / r if share > NEARLY_CUBIC * NEARLY_CUBIC else straight
                    x = min(x, knee) if below > 0.0 else max(x, knee)
    u = r * x
    if abs(u) < NEARLY_CUBIC:
        return -k3 * x * x * x * (1.0 - 0.4 * u * u) - k2 * x * x * (1.0 - u * u / 6.0)
    square = abs(u) + math.log1p(math.exp(-2.0 * abs(u))) - math.log(2.0)  # log(cosh(u))
    return -3.0 * k3 / bend * (x - math.tanh(u) / r) - 2.0 * k2 / bend * square


def laws(place: Place) -> list[Law]:
    """Return a cubic, straight or from a corner on, and a square."""
    largest = 0.5 * place.travel
    k3, k2 = 0.1 * place.stiffness / largest**2, 0.1 * place.stiffness / largest
    cubic = [one("k3", k3, both_signs=True, bend=bend, corner=0.0) for bend in (0.0, 9.0 / largest**2)]
    return [*cubic, one("k2", k2, both_signs=True, k3=0.0, bend=0.0, corner=0.0)]
