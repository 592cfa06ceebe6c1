"""Torque ripple: a motor constant that varies with the rotor's angle."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import RIPPLE, Effect, Parameter
from virtual_bus.effects.law import Law, Place, wave
from virtual_bus.effects.motion import DriveState

EFFECT = Effect(
    name="torque_ripple",
    plain="The motor's effort per ampere goes up and down as it turns.",
    kind=RIPPLE,
    parameters=(
        Parameter(
            "Np",
            unit="cycles/turn",
            low=0.001,
            high=100000.0,
            description="cycles per turn of the motor (a prismatic axis: radians per metre of the motor's coordinate)",
            is_strength=False,
        ),
        Parameter("A1", unit="", low=0.0, high=0.4, description="relative amplitude"),
        Parameter("phi1", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
        Parameter("A2", unit="", low=0.0, high=0.4, description="relative amplitude at twice the order"),
        Parameter("phi2", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
    ),
    equation="i Kt (1 + sum A_k cos(k Np motor + phi_k))",
    convention=(
        "motor effort = Kt i (1 + sum A_k cos(k Np N position + phi_k)), motor = N position; evaluated at the start of every "
        "plant step's motion"
    ),
    neighbours=("cogging", "transmission_error"),
    source="Hanselman 2006, Sec. 8",
    family="periodic_effort",
)


def factor(state: DriveState, Np: float, A1: float, phi1: float, A2: float, phi2: float) -> float:
    """Return the motor effort over its nominal value."""
    phase = Np * state.ratio * state.position
    return 1.0 + A1 * math.cos(phase + phi1) + A2 * math.cos(2.0 * phase + phi2)


def laws(place: Place) -> list[Law]:
    """Return orders of the motor's turn."""
    return [wave("A1", "phi1", 0.01, Np=order, A2=0.0, phi2=0.0) for order in place.orders(place.ratio)]
