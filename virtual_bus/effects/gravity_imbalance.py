"""Gravity imbalance: a weight on a lever that the machine file does not know."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import EFFORT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, wave
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="gravity_imbalance",
    plain="The axis is not balanced: its weight pulls it to one side, by an amount that changes with the position.",
    kind=EFFORT,
    parameters=(
        Parameter("mgr", unit="Nm", low=0.0, high=5000.0, description="weight times lever"),
        Parameter(
            "phi",
            unit="phase",
            low=-6.283185307179586,
            high=6.283185307179586,
            description="phase: no effort where position + phi = 0",
            is_strength=False,
        ),
    ),
    equation="mgr sin(position + phi)",
    convention=(
        "effort on the joint = -mgr sin(position + phi): hanging at position = -phi; gravity alone, without the mass's inertia "
        "(see payload); at a prismatic joint one radian is one metre"
    ),
    neighbours=("cable_spring", "constant_load", "transmission_error", "payload"),
    source="Featherstone 2008, Sec. 5.3, of one body",
    family="static_load",
    is_exact=True,
)


def effort(motion: JointMotion, mgr: float, phi: float) -> float:
    """Return the effort [Nm or N] on the joint."""
    return -mgr * math.sin(motion.position + phi)


def laws(place: Place) -> list[Law]:
    """Return a sine of free phase."""
    return [wave("mgr", "phi")]
