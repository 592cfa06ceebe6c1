"""Position-dependent friction: a Coulomb level that varies along the joint's travel."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, raised_wave
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="position_dependent_friction",
    plain="The joint rubs more at some positions than at others, as where a guide is worn or tight.",
    kind=FRICTION,
    parameters=(
        Parameter("Fc", unit="Nm", low=0.0, high=2000.0, description="largest level; it falls to 0 half a period on"),
        Parameter(
            "k",
            unit="cycles/turn",
            low=0.1,
            high=100000.0,
            description="periods per turn of the joint (a prismatic joint: radians per metre)",
            is_strength=False,
        ),
        Parameter(
            "phi",
            unit="phase",
            low=-6.283185307179586,
            high=6.283185307179586,
            description="phase: the level is largest where k position + phi = 0",
            is_strength=False,
        ),
    ),
    equation="Fc (1 + cos(k position + phi)) / 2 sign(speed)",
    convention=(
        "effort on the joint = -Fc (1 + cos(k position + phi)) / 2 sign(speed), on the joint's side of the gear; a joint at "
        "rest is held up to that level"
    ),
    neighbours=("load_dependent_friction", "coulomb_friction"),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, Sec. 2.1",
    family="dry_friction",
    sought_at=("axis",),
    left_out="at rest it holds, and in motion it has no slope",
)


def level(state: JointState, Fc: float, k: float, phi: float) -> float:
    """Return the friction level [Nm or N] at this position."""
    return 0.5 * Fc * (1.0 + math.cos(k * state.position + phi))


def laws(place: Place) -> list[Law]:
    """Return periods per turn from what the range shows up to some ten."""
    return [raised_wave("Fc", "phi", k=k) for k in (0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 18.0)]
