"""Thermal bending: a structure whose unloaded shape turns as it warms up."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import ELASTIC, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="thermal_bending",
    plain="The machine bends a little as it warms up.",
    kind=ELASTIC,
    parameters=(
        Parameter("bend", unit="rad", low=-0.1, high=0.1, description="how far the unloaded spring has moved when all is warm"),
        Parameter("tau", unit="s", low=0.1, high=100000.0, description="time constant of the warming", is_strength=False),
        Parameter(
            "warm_for", unit="s", low=0.0, high=1e6, description="how long it has been warming at the start", is_strength=False, default=0.0
        ),
    ),
    equation="K bend (1 - exp(-(t + warm_for) / tau))",
    convention=(
        "effort on the spring behind the axis (or under the body) = +K bend (1 - exp(-(t + warm_for) / tau)), K its stiffness: its rest "
        "position moves by bend towards positive position; at a standstill before the start t = 0"
    ),
    neighbours=("creep", "constant_load"),
    source="Boley and Weiner 1960, Sec. 9.2 (a free beam bends with the moment of its temperature), a body of one time constant",
    family="external",
    is_slow=True,
    left_out="it moves the machine by itself, whatever the drives do",
)


def effort(motion: JointMotion, bend: float, tau: float, warm_for: float) -> float:
    """Return the effort [Nm or N] on the sprung joint."""
    return -motion.stiffness * bend * math.expm1(-(max(motion.time_s, 0.0) + warm_for) / tau)


def laws(place: Place) -> list[Law]:
    """Return one strength at several times."""
    return [
        one("bend", max(place.effort, 1e-9) / max(place.stiffness, 1e-9), both_signs=True, tau=share * place.duration_s, warm_for=0.0)
        for share in (0.1, 0.3, 1.0, 3.0)
    ]
