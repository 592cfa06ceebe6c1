"""Cogging: magnets that pull towards the teeth, with or without current."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.effects.effect import EFFORT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, wave
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="cogging",
    plain="Magnets pull the motor towards certain positions, even without current, so that it runs in small steps.",
    kind=EFFORT,
    parameters=(
        Parameter(
            "Np",
            unit="cycles/turn",
            low=0.001,
            high=100000.0,
            description="cycles per turn of the motor (a prismatic axis: radians per metre of the motor's coordinate)",
            is_strength=False,
        ),
        Parameter("A1", unit="Nm", low=0.0, high=1000.0, description="amplitude at the joint"),
        Parameter("phi1", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
        Parameter("A2", unit="Nm", low=0.0, high=1000.0, description="amplitude at twice the order, at the joint"),
        Parameter("phi2", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
    ),
    equation="sum A_k cos(k Np motor + phi_k)",
    convention=(
        "effort on the joint = +sum A_k cos(k Np N position + phi_k), amplitudes on the joint's side of the gear (motor's times "
        "N), motor = N position"
    ),
    neighbours=("torque_ripple", "transmission_error", "encoder_eccentricity"),
    source="Hanselman 2006, Sec. 7",
    several="Np",
    family="periodic_effort",
)


def effort(motion: JointMotion, Np: float, A1: float, phi1: float, A2: float, phi2: float) -> float:
    """Return the effort [Nm or N] on the joint."""
    phase = Np * motion.ratio * motion.position
    return A1 * math.cos(phase + phi1) + A2 * math.cos(2.0 * phase + phi2)


def laws(place: Place) -> list[Law]:
    """Return orders of the motor's turn, alone and with twice the order."""
    orders = place.orders(place.ratio)
    return [wave("A1", "phi1", Np=order, A2=0.0, phi2=0.0) for order in orders] + [_of_order(order) for order in orders]


def _of_order(order: float) -> Law:
    """Return waves of an order and of twice the order."""
    first, second = wave("A1", "phi1", Np=order, A2=0.0, phi2=0.0), wave("A2", "phi2", Np=order, A1=0.0, phi1=0.0)

    def parameters(w: np.ndarray) -> dict[str, float]:
        one, other = first.parameters(w[:2]), second.parameters(w[2:])
        return {"Np": order, "A1": one["A1"], "phi1": one["phi1"], "A2": other["A2"], "phi2": other["phi2"]}

    return Law((*first.columns, *second.columns), parameters, -math.inf)
