"""Structural mode: an added inertia on a spring and damper, which is a pole-zero pair for everything that drives the joint."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.effects.effect import REACTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import ReactionSlopes, ReactionState

EFFECT = Effect(
    name="structural_mode",
    plain="A part of the machine swings on its own, like a mass on a spring.",
    kind=REACTION,
    parameters=(
        Parameter("J", unit="kg m^2", low=0.0, high=500.0, description="inertia that hangs on the spring"),
        Parameter(
            "f",
            unit="Hz",
            low=0.1,
            high=200.0,
            description="its natural frequency with the joint held: the zero",
            is_strength=False,
        ),
        Parameter("zeta", unit="", low=0.0, high=1.0, description="its damping ratio with the joint held", is_strength=False),
    ),
    equation="z'' + 2 zeta w z' + w^2 z = -joint'', effort = J (w^2 z + 2 zeta w z')",
    convention=(
        "z is the added inertia's motion relative to the joint; effort on the joint = +J (w^2 z + 2 zeta w z'), w = 2 pi f; at "
        "rest and unsprung at the start; gravity does not act on it; at a body it hangs on the body's joint"
    ),
    neighbours=("drive_bandwidth", "delay", "base_motion", "joint_compliance"),
    source="Den Hartog 1956, Sec. 3.2",
    family="elasticity",
    is_exact=True,
)


def react(state: ReactionState, J: float, f: float, zeta: float) -> tuple[float, float, float]:
    """Return the mean effort [Nm or N] over a step and the relative motion z, z' at its end.

    The closed form for a constant acceleration over the step.
    """
    w = 2.0 * math.pi * f
    pull = -(state.end_speed - state.start_speed) / state.step_s
    rest = pull / (w * w)
    x, v, h = state.first - rest, state.second, state.step_s
    decay = math.exp(-zeta * w * h)
    under = 1.0 - zeta * zeta
    if under > 1e-12:
        wd = w * math.sqrt(under)
        cos, sin = math.cos(wd * h), math.sin(wd * h) / wd
    else:
        cos, sin = 1.0, h
    end = decay * (cos * x + sin * (v + zeta * w * x)) + rest
    end_speed = decay * (cos * v - sin * (w * w * x + zeta * w * v))
    mean = pull - (end_speed - state.second) / h  # of w^2 z + 2 zeta w z' over the step, from its own equation
    return J * mean, end, end_speed


def slopes(J: float, f: float, zeta: float) -> ReactionSlopes:
    """Return the motion z, z' of the added inertia and its pull on the joint, as they are: the effect is linear."""
    w = 2.0 * math.pi * f
    pull = np.array([w * w, 2.0 * zeta * w])
    return ReactionSlopes(np.array([[0.0, 1.0], -pull]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), J * pull, (0.0, 0.0))


def laws(place: Place) -> list[Law]:
    """Return a twentieth of the inertia there, at frequencies over the whole band."""
    return [one("J", 0.05 * place.inertia, f=f, zeta=0.02) for f in place.grid_Hz(2.0) if f < 200.0]
