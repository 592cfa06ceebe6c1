"""Presliding hysteresis: bristles that bend before they slip (LuGre; Dahl with a constant level and no bristle damping)."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import REACTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place
from virtual_bus.effects.motion import ReactionState

EFFECT = Effect(
    name="presliding_hysteresis",
    plain="Before it slides, the joint gives way a little like a spring, as bristles bend before they slip.",
    kind=REACTION,
    parameters=(
        Parameter("Fc", unit="Nm", low=0.0, high=2000.0, description="level of steady sliding"),
        Parameter("Fs_minus_Fc", unit="Nm", low=0.0, high=2000.0, description="break-away level above the sliding level"),
        Parameter("vs", unit="rad/s", low=1e-05, high=1.0, description="Stribeck speed", is_strength=False, sought=(1e-05, 1.0)),
        Parameter("sigma0", unit="Nm/rad", low=0.01, high=1000000000.0, description="stiffness of the bristles", is_strength=False),
        Parameter("sigma1", unit="Nm s/rad", low=0.0, high=100000.0, description="damping of the bristles", is_strength=False),
    ),
    equation="z' = w - sigma0 abs(w) z / g(w), F = sigma0 z + sigma1 z', g = Fc + (Fs - Fc) exp(-(w / vs)^2)",
    convention=(
        "effort on the joint = -(sigma0 z + sigma1 z'), on the joint's side of the gear, in place of coulomb_friction and "
        "stribeck_friction, not besides them; viscous friction is an effect of its own; bristles are unbent at the start"
    ),
    neighbours=("backlash", "stribeck_friction", "bouc_wen_hysteresis"),
    source="Canudas de Wit, Olsson, Åström, Lischinsky 1995, eqs. (1)-(4); Dahl 1968",
    family="dry_friction",
    parent="coulomb_friction",
    left_out="bristles are a spring until they slip, then friction",
)


def react(state: ReactionState, Fc: float, Fs_minus_Fc: float, vs: float, sigma0: float, sigma1: float) -> tuple[float, float, float]:
    """Return the mean effort [Nm or N] over a step and the bend of the bristles [rad or m] at its end.

    The speed is taken as constant over the step; for it the bristles' motion is exact.
    """
    speed = 0.5 * (state.start_speed + state.end_speed)
    g = Fc + Fs_minus_Fc * math.exp(-((speed / vs) ** 2))
    if g <= 0.0:
        return 0.0, 0.0, 0.0
    x = sigma0 * abs(speed) * state.step_s / g
    if x < 1e-9:
        end = state.first + speed * state.step_s
        mean = state.first + 0.5 * speed * state.step_s
    else:
        steady = g / sigma0 if speed > 0.0 else -g / sigma0
        gone = -math.expm1(-x)
        end = state.first + (steady - state.first) * gone
        mean = steady + (state.first - steady) * gone / x
    return -(sigma0 * mean + sigma1 * (end - state.first) / state.step_s), end, 0.0


def laws(place: Place) -> list[Law]:
    """Return a level that is reached after several displacements: the bristles' bend at it."""
    return [_bent_by(place.travel * share, max(0.1 * place.effort, 1e-9)) for share in (0.001, 0.003, 0.01, 0.03)]


def _bent_by(bend: float, level: float) -> Law:
    """Return the law whose bristles slip after this bend, at any level."""
    rest = {"Fs_minus_Fc": 0.0, "vs": 0.01, "sigma1": 0.0}
    columns = ({"Fc": level, "sigma0": level / bend, **rest},)
    return Law(columns, lambda w: {"Fc": level * float(w[0]), "sigma0": level * float(w[0]) / bend, **rest})
