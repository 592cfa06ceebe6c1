"""Viscous friction: an effort against motion in proportion to its speed."""

from __future__ import annotations

from virtual_bus.effects.effect import JOINT_CHANGE, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one

EFFECT = Effect(
    name="viscous_friction",
    plain="The joint resists motion in proportion to its speed, as thick oil does.",
    kind=JOINT_CHANGE,
    parameters=(
        Parameter("Fv", unit="Nm s/rad", low=0.0, high=2000.0, description="viscous coefficient, added to the damping of the machine file"),
    ),
    equation="Fv speed",
    convention="effort on the joint = -Fv speed, on the joint's side of the gear, in addition to the joint's own damping",
    neighbours=("coulomb_friction", "quadratic_friction", "drive_bandwidth"),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, eq. (4)",
    family="viscous_friction",
    everyday=True,
    sought_at=("axis",),
)


def _damping(value: float, Fv: float) -> float:
    return value + Fv


CHANGES = (("joint", "damping", _damping),)


def laws(place: Place) -> list[Law]:
    """Return one coefficient."""
    return [one("Fv")]
