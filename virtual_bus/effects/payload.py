"""Payload: an additional mass at a body's centre of mass, with its inertia and its weight."""

from __future__ import annotations

from virtual_bus.effects.effect import BODY_CHANGE, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one

EFFECT = Effect(
    name="payload",
    plain="Somebody has added a mass: it is heavier to hold and harder to accelerate.",
    kind=BODY_CHANGE,
    parameters=(Parameter("dm", unit="kg", low=0.0, high=500.0, description="mass added"),),
    equation="inertia and gravity of dm at the body's centre of mass",
    convention="the body's mass grows by dm at the centre of mass the machine file gives; acts at a body that has a mass",
    neighbours=("torque_constant", "gravity_imbalance"),
    source="Featherstone 2008, Sec. 2.13",
    family="inertia",
    is_exact=True,
)


def _mass(value: float, dm: float) -> float:
    return value + dm


CHANGES = (("body", "mass", _mass),)


def laws(place: Place) -> list[Law]:
    """Return one mass."""
    return [one("dm")]
