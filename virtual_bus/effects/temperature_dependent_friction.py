"""Temperature-dependent friction: a viscous friction that falls as the lubricant warms up."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.effects.effect import REACTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import ReactionSlopes, ReactionState

EFFECT = Effect(
    name="temperature_dependent_friction",
    plain="Grease gets thinner as it warms up: the same motion takes less effort after a while.",
    kind=REACTION,
    parameters=(
        Parameter(
            "Fv0",
            unit="Nm s/rad",
            low=0.0,
            high=2000.0,
            description="viscous coefficient at the start, added to the damping of the machine file",
        ),
        Parameter("a", unit="1/K", low=0.0, high=0.2, description="relative fall per kelvin of warming", is_strength=False),
        Parameter(
            "R",
            unit="K/W",
            low=0.0,
            high=1e6,
            description="steady warming per watt of this friction's power: from a housing in air to the oil of a contact in a small guide",
            is_strength=False,
        ),
        Parameter("tau", unit="s", low=1.0, high=10000.0, description="time constant of the warming", is_strength=False),
    ),
    equation="Fv0 exp(-a (T - T0)) speed, tau T' = R Fv speed^2 - (T - T0)",
    convention=(
        "effort on the joint = -Fv(T) speed, on the joint's side of the gear; the lubricant is as cold as the room at the start "
        "and warmed by this friction alone"
    ),
    neighbours=("viscous_friction", "torque_constant", "cable_spring"),
    source="Bittencourt and Gunnarsson 2012, eq. (9)",
    family="viscous_friction",
    parent="viscous_friction",
    left_out="the cold coefficient is taken: it falls as the lubricant warms",
    left_out_of=("a",),
)


def react(state: ReactionState, Fv0: float, a: float, R: float, tau: float) -> tuple[float, float, float]:
    """Return the mean effort [Nm or N] over a step and the warming [K] at its end; the second state is unused."""
    speed = 0.5 * (state.start_speed + state.end_speed)
    coefficient = Fv0 * math.exp(-a * state.first)
    final = R * coefficient * speed * speed
    warming = final + (state.first - final) * math.exp(-state.step_s / tau)
    return -coefficient * speed, warming, 0.0


def slopes(Fv0: float, a: float, R: float, tau: float) -> ReactionSlopes:
    """Return the friction of the cold lubricant: small motions do not warm it."""
    return ReactionSlopes(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros(0), (0.0, -Fv0))


def laws(place: Place) -> list[Law]:
    """Return a coefficient that halves within the recording at the power that it has there."""
    power = max(place.effort * place.speed, 1e-9)
    return [one("Fv0", a=0.02, R=40.0 / power, tau=tau) for tau in (0.2 * place.duration_s + 1.0, place.duration_s + 1.0)]
