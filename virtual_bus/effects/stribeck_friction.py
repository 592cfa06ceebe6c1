"""Stribeck friction: what a joint holds beyond its Coulomb friction at rest or creeping, or holds less, gone at higher speed."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="stribeck_friction",
    plain="The joint sticks: starting it takes more effort, or less, than keeping it in slow motion.",
    kind=FRICTION,
    parameters=(
        Parameter(
            "Fs_minus_Fc",
            unit="Nm",
            low=-2000.0,
            high=2000.0,
            description="break-away level above the Coulomb level; negative: friction is lower at rest",
            sought=(0.0, math.inf),
        ),
        Parameter(
            "vs",
            unit="rad/s",
            low=1e-5,
            high=1.0,
            description="Stribeck speed: where the excess is down to 1/e",
            is_strength=False,
            sought=(1e-5, 1.0),
        ),
        Parameter("delta", unit="", low=0.5, high=2.0, description="shape exponent", is_strength=False),
    ),
    equation="(Fs - Fc) exp(-abs(speed / vs)^delta) sign(speed)",
    convention=(
        "effort on the joint = -(Fs - Fc) exp(-abs(speed / vs)^delta) sign(speed), on the joint's side of the gear, in addition to "
        "coulomb_friction: break-away is Fc + (Fs - Fc), and never less than nothing"
    ),
    neighbours=("coulomb_friction", "presliding_hysteresis"),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, eq. (5); Bo and Pavelescu 1982",
    family="dry_friction",
    parent="coulomb_friction",
    sought_at=("axis",),
    left_out="at rest it holds, and in motion it falls with speed",
)


def level(state: JointState, Fs_minus_Fc: float, vs: float, delta: float) -> float:
    """Return the friction level above Coulomb friction [Nm or N]."""
    return Fs_minus_Fc * math.exp(-((state.speed / vs) ** delta))


def laws(place: Place) -> list[Law]:
    """Return one level above Coulomb's, or below, falling or rising at several speeds."""
    return [one("Fs_minus_Fc", value, vs=min(max(vs, 1e-5), 1.0), delta=2.0) for value in (1.0, -1.0) for vs in place.speeds()]
