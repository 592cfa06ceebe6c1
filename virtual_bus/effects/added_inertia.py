"""Added inertia: a joint that is harder to accelerate than the machine file says, or easier, and no heavier."""

from __future__ import annotations

from virtual_bus.effects.effect import JOINT_CHANGE, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one

EFFECT = Effect(
    name="added_inertia",
    plain="The axis is harder to speed up and slow down than expected, as with a flywheel on it, yet it is no heavier.",
    kind=JOINT_CHANGE,
    parameters=(
        Parameter(
            "J",
            unit="kg m^2",
            low=-1000.0,
            high=1000.0,
            description="moment of inertia about the joint's axis (sliding: mass), added to the machine file's; may be negative",
        ),
    ),
    equation="J joint''",
    convention=(
        "effort on the joint = -J joint'', on the joint's side of the gear: a rotor's inertia counts with its ratio squared; gravity does "
        "not act on it; refused where a joint's inertia would not stay positive; at a body it is about the body's joint"
    ),
    neighbours=("payload", "torque_constant", "structural_mode"),
    source="Featherstone 2008, Sec. 9.6 (rotor inertia)",
    family="inertia",
    everyday=True,
    is_exact=True,
    sought_at=(),
)


def _armature(value: float, J: float) -> float:
    return value + J


CHANGES = (("joint", "armature", _armature),)


def laws(place: Place) -> list[Law]:
    """Return a tenth of the inertia there."""
    return [one("J", 0.1 * place.inertia, both_signs=True)]
