"""Constant load: an effort that is always there."""

from __future__ import annotations

from virtual_bus.effects.effect import EFFORT, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointMotion

EFFECT = Effect(
    name="constant_load",
    plain="Something pushes always the same way with the same effort, such as a wrong balance weight or an offset of the drive.",
    kind=EFFORT,
    parameters=(Parameter("tau0", unit="Nm", low=-5000.0, high=5000.0, description="the effort"),),
    equation="tau0",
    convention="effort on the joint = +tau0: positive pushes towards positive position, on the joint's side of the gear",
    neighbours=("gravity_imbalance", "asymmetric_friction"),
    source="Janot, Gautier, Brunot 2019 (EMPS), the force offset",
    family="static_load",
    is_exact=True,
    everyday=True,
)


def effort(motion: JointMotion, tau0: float) -> float:
    """Return the effort [Nm or N] on the joint."""
    return tau0


def laws(place: Place) -> list[Law]:
    """Return one effort."""
    return [one("tau0", both_signs=True)]
