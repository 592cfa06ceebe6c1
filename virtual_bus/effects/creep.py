"""Creep: a support that gives way further while a load stands on it, and comes back as slowly."""

from __future__ import annotations

import math

import numpy as np

from virtual_bus.effects.effect import REACTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import ReactionSlopes, ReactionState

EFFECT = Effect(
    name="creep",
    plain="Under a steady load the machine goes on giving way slowly, as rubber does, and comes back as slowly.",
    kind=REACTION,
    parameters=(
        Parameter("k1", unit="Nm/rad", low=0.0, high=1e9, description="stiffness that relaxes, beside the joint's spring"),
        Parameter("tau", unit="s", low=0.1, high=100000.0, description="time in which it relaxes to 1/e", is_strength=False),
    ),
    equation="z' = speed - z / tau, F = k1 z",
    convention=(
        "effort on the joint = -k1 z, a spring in series with a damper (Maxwell) beside the joint's own spring K: under a constant "
        "load the deflection creeps from load / (K + k1) to load / K with the time constant tau (K + k1) / K; z = 0 at the start, "
        "where the machine has stood for long"
    ),
    neighbours=("bouc_wen_hysteresis", "thermal_bending"),
    source="the standard linear solid: Findley, Lai, Onaran 1976, Sec. 5.5",
    family="elasticity",
    is_slow=True,
)


def react(state: ReactionState, k1: float, tau: float) -> tuple[float, float, float]:
    """Return the mean effort [Nm or N] over a step and the bend of the relaxing spring [rad or m] at its end.

    The speed is taken as constant over the step; for it the bend is exact.
    """
    steady = 0.5 * (state.start_speed + state.end_speed) * tau
    x = state.step_s / tau
    gone = -math.expm1(-x)
    end = state.first + (steady - state.first) * gone
    mean = steady + (state.first - steady) * gone / x
    return -k1 * mean, end, 0.0


def slopes(k1: float, tau: float) -> ReactionSlopes:
    """Return the bend of the relaxing spring and its pull, as they are: the effect is linear."""
    return ReactionSlopes(np.array([[-1.0 / tau]]), np.array([[0.0, 1.0, 0.0]]), np.array([-k1]), (0.0, 0.0))


def laws(place: Place) -> list[Law]:
    """Return one strength at several times."""
    return [one("k1", tau=share * place.duration_s) for share in (0.03, 0.1, 0.3, 1.0)]
