"""Pose-dependent dynamics: an inertia that varies with the next axis's position."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import COUPLING, Effect, Parameter
from virtual_bus.effects.law import Law, Place, raised_wave
from virtual_bus.effects.motion import PairMotion

EFFECT = Effect(
    name="pose_dependent_dynamics",
    plain="The axis is harder to accelerate in some poses of the next axis than in others.",
    kind=COUPLING,
    parameters=(
        Parameter("dJ", unit="kg m^2", low=0.0, high=1000.0, description="largest inertia added; none half a turn of the next axis on"),
        Parameter(
            "phi",
            unit="phase",
            low=-6.283185307179586,
            high=6.283185307179586,
            description="phase: largest where the next axis's position + phi = 0",
            is_strength=False,
        ),
    ),
    equation="J(q2) = dJ (1 + cos(q2 + phi)) / 2 added to the axis's inertia, with the velocity terms of that kinetic energy",
    convention=(
        "kinetic energy J(q2) speed^2 / 2 is added; q2 is the next axis in the machine's order, the first one after the last; "
        "one joint radian is one metre at a prismatic next axis"
    ),
    neighbours=("structural_mode", "axis_coupling"),
    source="Spong, Hutchinson, Vidyasagar 2006, Sec. 7.2",
    family="inertia",
)


def terms(pair: PairMotion, dJ: float, phi: float) -> tuple[float, float, float, float]:
    """Return the axis's added inertia and the efforts [Nm or N] on both axes."""
    inertia = 0.5 * dJ * (1.0 + math.cos(pair.other_position + phi))
    slope = -0.5 * dJ * math.sin(pair.other_position + phi)
    return inertia, 0.0, -slope * pair.speed * pair.other_speed, 0.5 * slope * pair.speed * pair.speed


def laws(place: Place) -> list[Law]:
    """Return a raised cosine of free phase."""
    return [raised_wave("dJ", "phi", 0.05 * place.inertia)]
