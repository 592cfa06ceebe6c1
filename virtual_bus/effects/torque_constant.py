"""Torque constant: a motor that gives more or less per ampere than its plate says."""

from __future__ import annotations

from virtual_bus.effects.effect import CHANGE, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one

EFFECT = Effect(
    name="torque_constant",
    plain="The motor gives more or less effort per ampere than its plate says.",
    kind=CHANGE,
    parameters=(Parameter("eps", unit="", low=-0.5, high=1.0, description="relative error of the constant"),),
    equation="Kt (1 + eps)",
    convention="effort per unit of the drive is (1 + eps) times the machine file's",
    neighbours=("coulomb_friction", "payload", "gear_ratio"),
    source="thesis ch. 2; docs/explanation/notation.md, Signs",
    family="drive_gain",
    is_exact=True,
)


def _constant(value: float, eps: float) -> float:
    return value * (1.0 + eps)


CHANGES = (("axis", "constant", _constant),)


def laws(place: Place) -> list[Law]:
    """Return one per cent."""
    return [one("eps", 0.01, both_signs=True)]
