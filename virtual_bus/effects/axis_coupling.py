"""Axis coupling: an inertia by which one axis's acceleration loads the other."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import COUPLING, Effect, Parameter
from virtual_bus.effects.law import Law, Place, wave
from virtual_bus.effects.motion import PairMotion

EFFECT = Effect(
    name="axis_coupling",
    plain="When one axis speeds up, it pushes another one along, because a mass is shared between them.",
    kind=COUPLING,
    parameters=(
        Parameter("J12", unit="kg m^2", low=-500.0, high=500.0, description="coupling inertia where the next axis's position + phi = 0"),
        Parameter("phi", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
    ),
    equation="J12(q2) q2'' on the axis and J12(q2) q1'' on the next, J12(q2) = J12 cos(q2 + phi), with the velocity terms",
    convention=(
        "kinetic energy J12 cos(q2 + phi) speed1 speed2 is added; q2 is the next axis in the machine's order, the first one "
        "after the last; refused where the inertia would stop being positive definite"
    ),
    neighbours=("imu_misalignment", "pose_dependent_dynamics"),
    source="Spong, Hutchinson, Vidyasagar 2006, Sec. 7.2",
    family="inertia",
    is_exact=True,
)


def terms(pair: PairMotion, J12: float, phi: float) -> tuple[float, float, float, float]:
    """Return the coupling inertia and the efforts [Nm or N] on both axes.

    Only the first axis feels the second one's squared speed.
    """
    coupling = J12 * math.cos(pair.other_position + phi)
    slope = -J12 * math.sin(pair.other_position + phi)
    return 0.0, coupling, -slope * pair.other_speed * pair.other_speed, 0.0


def laws(place: Place) -> list[Law]:
    """Return a cosine of free phase."""
    return [wave("J12", "phi", 0.01 * place.inertia)]
