"""Stribeck friction: what a joint at rest or creeping holds beyond its Coulomb friction, gone at higher speed."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import FRICTION, Effect, JointState, Parameter

EFFECT = Effect(
    name="stribeck_friction",
    kind=FRICTION,
    parameters=(
        Parameter("Fs_minus_Fc", unit="Nm", low=0.0, high=2000.0, description="break-away level above the Coulomb level"),
        Parameter("vs", unit="rad/s", low=1e-5, high=1.0, description="Stribeck speed: at it the excess has fallen to 1/e"),
        Parameter("delta", unit="", low=0.5, high=2.0, description="shape exponent"),
    ),
    convention=(
        "effort on the joint = -(Fs - Fc) exp(-abs(speed / vs)^delta) sign(speed), on the joint's side of the gear, in addition to "
        "coulomb_friction: break-away is Fc + (Fs - Fc)"
    ),
    neighbours=("coulomb_friction", "presliding_hysteresis"),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, eq. (5); Bo and Pavelescu 1982",
)


def level(state: JointState, Fs_minus_Fc: float, vs: float, delta: float) -> float:
    """Friction level above Coulomb [Nm or N]."""
    return Fs_minus_Fc * math.exp(-((state.speed / vs) ** delta))
