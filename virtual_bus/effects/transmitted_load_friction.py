"""Friction of the load that a gear transmits: its motor's effort on one side, gravity's on the other."""

from __future__ import annotations

import math

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, each
from virtual_bus.effects.motion import JointState

EFFECT = Effect(
    name="transmitted_load_friction",
    plain="The gear rubs the more, the harder motor and load press its teeth together, and most just before it moves.",
    kind=FRICTION,
    parameters=(
        Parameter("Km", unit="", low=0.0, high=0.9, description="friction per effort of the motor", default=0.0),
        Parameter("Kg", unit="", low=0.0, high=0.9, description="friction per effort that the load asks for", default=0.0),
        Parameter("Km_rest", unit="", low=0.0, high=2.0, description="further friction per effort of the motor at rest", default=0.0),
        Parameter(
            "Kg_rest", unit="", low=0.0, high=2.0, description="further friction per effort that the load asks for at rest", default=0.0
        ),
        Parameter(
            "vs",
            unit="rad/s",
            low=1e-5,
            high=1.0,
            description="speed at which what is there at rest is down to 1/e",
            is_strength=False,
            default=0.1,
        ),
        Parameter("delta", unit="", low=0.5, high=2.0, description="shape exponent", is_strength=False, default=2.0),
    ),
    equation="(abs(Km motor + Kg load) + abs(Km_rest motor + Kg_rest load) exp(-abs(speed / vs)^delta)) sign(speed)",
    convention=(
        "effort on the joint = minus that, on the joint's side of the gear; motor is as in motor_load_friction, load as in "
        "load_dependent_friction with its sign: gravity acts with -load, so that both add up where the motor holds a weight "
        "(abs(Km motor - Kg gravity) of the source); a joint at rest is held up to that level"
    ),
    neighbours=("motor_load_friction", "load_dependent_friction", "stribeck_friction", "supply_resistance"),
    source="Duclusaud, Passault, Padois, Ly 2024 (arXiv:2410.08650), models M4 and M5",
    family="dry_friction",
    parent="motor_load_friction",
    sought_at=(),
    left_out="at rest it holds, and in motion it changes sign with the direction",
)


def level(state: JointState, Km: float, Kg: float, Km_rest: float, Kg_rest: float, vs: float, delta: float) -> float:
    """Return the friction level [Nm or N]."""
    excess = abs(Km_rest * state.motor + Kg_rest * state.load)
    return abs(Km * state.motor + Kg * state.load) + excess * math.exp(-((state.speed / vs) ** delta))


def laws(place: Place) -> list[Law]:
    """Return shares of motor and load, at all speeds alike or at rest."""
    moving = each(("Km", "Kg"), 0.1, Km_rest=0.0, Kg_rest=0.0, vs=0.1, delta=2.0)
    resting = [each(("Km_rest", "Kg_rest"), 0.1, Km=0.0, Kg=0.0, vs=min(max(vs, 1e-5), 1.0), delta=2.0) for vs in place.speeds()]
    return [moving, *resting]
