"""Transmission error: a gear whose output runs ahead and behind in every turn of the motor."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import TRANSMISSION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, wave
from virtual_bus.effects.motion import PairMotion

EFFECT = Effect(
    name="transmission_error",
    plain="Teeth that are not perfect: the load runs ahead and behind a little in every turn of a gear.",
    kind=TRANSMISSION,
    parameters=(
        Parameter(
            "k",
            unit="cycles/turn",
            low=0.001,
            high=100000.0,
            description="cycles per turn of the motor (a prismatic axis: radians per metre of the motor's coordinate)",
            is_strength=False,
        ),
        Parameter("e1", unit="rad", low=0.0, high=0.01, description="amplitude of the output's error, at the joint"),
        Parameter("phi1", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
        Parameter("e2", unit="rad", low=0.0, high=0.01, description="amplitude at twice the order"),
        Parameter("phi2", unit="phase", low=-6.283185307179586, high=6.283185307179586, description="phase", is_strength=False),
    ),
    equation="link = motor / N + sum e_j cos(j k motor + phi_j)",
    convention=(
        "the spring behind the axis rests at e(motor) = sum e_j cos(j k N position + phi_j) instead of its rest position, motor "
        "= N position; the reaction on the motor side follows from the spring's energy; N 1 makes k an order of the output "
        "shaft"
    ),
    neighbours=("cogging", "encoder_eccentricity", "cable_spring"),
    source="Tuttle and Seering 1996, eq. (1)",
    family="periodic_position",
)


def terms(pair: PairMotion, k: float, e1: float, phi1: float, e2: float, phi2: float) -> tuple[float, float, float, float]:
    """Return no inertia, and the efforts [Nm or N] on the axis's joint and on its spring."""
    phase = k * pair.ratio * pair.position
    error = e1 * math.cos(phase + phi1) + e2 * math.cos(2.0 * phase + phi2)
    slope = -k * pair.ratio * (e1 * math.sin(phase + phi1) + 2.0 * e2 * math.sin(2.0 * phase + phi2))
    return 0.0, 0.0, pair.stiffness * (pair.other_position - error) * slope, pair.stiffness * error


def laws(place: Place) -> list[Law]:
    """Return orders of the motor's turn."""
    return [
        wave("e1", "phi1", 1e-5, k=order / place.ratio if by_joint else order, e2=0.0, phi2=0.0)
        for by_joint in (True, False)
        for order in place.orders(1.0 if by_joint else place.ratio)
    ]
