"""Bouc-Wen hysteresis: a restoring effort whose stiffness falls along the path since the last reversal."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import REACTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import ReactionState

EFFECT = Effect(
    name="bouc_wen_hysteresis",
    plain="A spring that rubs inside: it does not come back the way it went, and so takes energy out of every swing.",
    kind=REACTION,
    parameters=(
        Parameter("k", unit="Nm/rad", low=0.0, high=100000000.0, description="effort per hysteretic displacement"),
        Parameter("A", unit="", low=0.0, high=1.0, description="initial slope of the displacement over the motion", is_strength=False),
        Parameter(
            "z_max",
            unit="rad",
            low=1e-09,
            high=1.0,
            description="displacement at which the loop is flat: the (A / (beta + gamma))^(1/n) of the source",
            is_strength=False,
        ),
        Parameter(
            "beta_share",
            unit="",
            low=0.5,
            high=1.0,
            description="beta / (beta + gamma): 0.5 unloads along the initial slope, 1 softens both ways",
            is_strength=False,
        ),
        Parameter("n", unit="", low=1.0, high=8.0, description="sharpness of the knee", is_strength=False),
    ),
    equation="z' = A w - beta abs(w) abs(z)^(n-1) z - gamma w abs(z)^n, F = k z",
    convention=(
        "effort on the joint = -k z, on the joint's side of the gear, in addition to its spring; beta + gamma = A / z_max^n; z "
        "= 0 at the start"
    ),
    neighbours=("presliding_hysteresis", "nonlinear_stiffness"),
    source="Wen 1976; Noël and Kerschen 2017, Sec. 2.2",
    family="hysteresis",
    left_out="a spring at first, and flat where its loop is closed",
)


MOST_PARTS = 8  # into which the path within a step is cut
PART = 0.05  # of z_max / (A n), the path along which the law bends; at a steady speed the error of one part is z_max / n PART^3 / 12


def react(state: ReactionState, k: float, A: float, z_max: float, beta_share: float, n: float) -> tuple[float, float, float]:
    """Return the mean effort [Nm or N] over a step and the displacement z [rad or m] at its end, by Heun's rule along the path."""
    bends = abs(state.start_speed) * state.step_s * A * n / (PART * z_max)  # of the start's speed alone, which no iteration changes
    parts = 1 + int(bends) if bends < MOST_PARTS else MOST_PARTS
    path = 0.5 * (state.start_speed + state.end_speed) * state.step_s / parts
    onward = 1.0 if path > 0.0 else -1.0
    z = state.first
    total = 0.0
    for _ in range(parts):
        begin = z
        slope = A * (1.0 - (abs(z) / z_max) ** n * (1.0 - beta_share + beta_share * onward * math.copysign(1.0, z)))
        ahead = min(max(z + path * slope, -z_max), z_max)
        slope_ahead = A * (1.0 - (abs(ahead) / z_max) ** n * (1.0 - beta_share + beta_share * onward * math.copysign(1.0, ahead)))
        z = min(max(z + 0.5 * path * (slope + slope_ahead), -z_max), z_max)
        total += 0.5 * (begin + z)
    return -k * total / parts, z, 0.0


def laws(place: Place) -> list[Law]:
    """Return a loop that is flat after several displacements."""
    return [one("k", A=1.0, z_max=min(place.travel * share, 1.0), beta_share=0.5, n=1.0) for share in (0.003, 0.01, 0.03, 0.1)]
