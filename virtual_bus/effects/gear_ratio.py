"""Gear ratio: a gear that turns the joint less per motor turn than the machine file says."""

from __future__ import annotations

from virtual_bus.effects.effect import CHANGE, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one

EFFECT = Effect(
    name="gear_ratio",
    plain="The gear turns the load by more or less per turn of the motor than the machine file says.",
    kind=CHANGE,
    parameters=(
        Parameter("beta", unit="", low=-0.5, high=0.5, description="relative error of the ratio"),
    ),  # as far as the next ratio that a maker offers
    equation="N (1 + beta)",
    convention=(
        "the ratio is N (1 + beta): the motor's side turns (1 + beta) times as far, so position reads start + (1 + beta) "
        "travel, effort on the joint grows by 1 + beta and the rotor's inertia by its square; link encoders do not see it"
    ),
    neighbours=("encoder_eccentricity", "torque_constant"),
    source="docs/explanation/notation.md, Signs",
    family="gearing",
    is_exact=True,
)


def _ratio(value: float, beta: float) -> float:
    return value * (1.0 + beta)


def _armature(value: float, beta: float) -> float:
    return value * (1.0 + beta) ** 2


CHANGES = (("axis", "ratio", _ratio), ("joint", "armature", _armature))


def error(position: float, beta: float) -> float:
    """Return what the motor's encoder sees beyond the joint's position [rad or m]."""
    return beta * position


def laws(place: Place) -> list[Law]:
    """Return a tenth of a per cent, where a sensor beyond the gear shows it: else it is a change of the machine's numbers."""
    return [one("beta", 0.001, both_signs=True)] if place.is_seen_twice else []
