"""Quadratic friction: an effort against motion that grows with the square of its speed."""

from __future__ import annotations

import numpy as np

from virtual_bus.effects.effect import FRICTION, Effect, Parameter
from virtual_bus.effects.law import Law, Place, one
from virtual_bus.effects.motion import JointState
from virtual_bus.effects.residual import Residual, fitted

EFFECT = Effect(
    name="quadratic_friction",
    kind=FRICTION,
    parameters=(Parameter("Fv2", unit="Nm s^2/rad^2", low=0.0, high=5000.0, description="effort per squared speed"),),
    equation="Fv2 speed abs(speed)",
    convention="effort on the joint = -Fv2 speed abs(speed), on the joint's side of the gear",
    neighbours=("viscous_friction",),
    source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, Sec. 2.1",
    family="viscous_friction",
)


def level(state: JointState, Fv2: float) -> float:
    """Return the friction level [Nm or N]."""
    return Fv2 * state.speed * state.speed


def guess(residual: Residual) -> tuple[float]:
    """Take the part of the missing effort along speed abs(speed), beside viscous and Coulomb friction and a load."""
    speed = residual.speed
    return (float(fitted([-speed * np.abs(speed), -speed, -np.sign(speed), np.ones_like(speed)], residual.effort)[0]),)


def laws(place: Place) -> list[Law]:
    """Return one coefficient."""
    return [one("Fv2")]
