"""Bounds of effects' parameters at a place of a machine.

The catalogue's own are for machines of any size. What a large machine has more of - effort, inertia, travel - widens them there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from virtual_bus.compilation.cache_keys import Same
from virtual_bus.effects.effect import Effect, Parameter
from virtual_bus.effects.places import joint_of_place
from virtual_bus.effects.registry import effects
from virtual_bus.settings import Body, Drive, Joint, PlantSettings

TIMES = 10.0
"""Of the effort that drives and weight have, or of the inertia that moves: more of an effect would leave nothing else to be seen."""
FINEST = 1e-6
"""Of the travel: over which a spring's law bends at most."""
TURN = 2.0 * math.pi
"""rad: travel of a joint that turns, for which the catalogue's positions are stated; a joint of more travel has longer ones."""


@dataclass(frozen=True)
class Size:
    """What a joint of a machine has to do with.

    Attributes
    ----------
    effort : float
        Of drives and weight [Nm or N].
    inertia : float
        Of all that moves with the joint, at its farthest [kg m^2 or kg].
    travel : float
        Between the ends of its positions, at least a turn [rad or m].
    period_s : float
        Of a row.
    command : float
        Largest of its drive [its unit]; 0 without one.
    """

    effort: float
    inertia: float
    travel: float
    period_s: float
    command: float

    @property
    def speed(self) -> float:
        """Speed that the effort gives the inertia over the travel [rad/s or m/s]."""
        return math.sqrt(2.0 * self.effort * self.travel / self.inertia)

    @property
    def damping(self) -> float:
        """Damping that stops the inertia within a row [Nm s/rad or N s/m]."""
        return self.inertia / self.period_s

    @property
    def stiffness(self) -> float:
        """Stiffness on which the inertia swings at half the rows' rate: a stiffer spring shows as none [Nm/rad or N/m]."""
        return self.inertia * (math.pi / self.period_s) ** 2

    def most(self, unit: str) -> float:
        """Return the largest number of this unit (of a joint that turns) that a machine of this size has; 0 where size says nothing."""
        finest = FINEST * self.travel
        return {
            "Nm": TIMES * self.effort,
            "kg m^2": TIMES * self.inertia,
            "kg": TIMES * self.inertia,
            "Nm s/rad": self.damping,
            "Nm s^2/rad^2": self.damping / self.speed if self.speed > 0.0 else 0.0,
            "Nm s/rad^2": self.damping / finest,
            "Nm s/rad^3": self.damping / finest**2,
            "Nm/rad": self.stiffness,
            "Nm/rad^2": self.stiffness / finest,
            "Nm/rad^3": self.stiffness / finest**2,
            "rad/Nm": self.travel / self.effort if self.effort > 0.0 else 0.0,
            "rad/s": self.speed,
            "A": TIMES * self.command,
            "A s/rad": TIMES * self.command / self.speed if self.speed > 0.0 else 0.0,
        }.get(unit, 0.0)


def effect_at(name: str, at: str, settings: PlantSettings) -> Effect:
    """Return an effect with the bounds of its parameters at a place of a machine."""
    return _effect_at(name, at, Same(settings))


@lru_cache(maxsize=1024)
def _effect_at(name: str, at: str, of: Same[PlantSettings]) -> Effect:
    effect = effects()[name]
    joint = joint_of_place(effect.kind, at, of.it)
    if joint is None:
        return effect
    size = _size(joint, of)
    return replace(effect, parameters=tuple(_widened(parameter, size) for parameter in effect.parameters))


def _widened(parameter: Parameter, size: Size) -> Parameter:
    if parameter.unit == "rad":
        longer = max(size.travel / TURN, 1.0)
        return replace(parameter, low=min(parameter.low, longer * parameter.low), high=longer * parameter.high)
    most = max(size.most(parameter.unit), parameter.high)
    low = -max(size.most(parameter.unit), -parameter.low) if parameter.low < 0.0 else parameter.low
    return replace(parameter, low=low, high=most, neutral=most if parameter.neutral == parameter.high else parameter.neutral)


@lru_cache(maxsize=256)
def _size(joint: str, of: Same[PlantSettings]) -> Size:
    """Return the size of a joint.

    Effort divided by the root of the inertia is the same for joints that turn and that slide: so much of every drive's may reach the joint.
    """
    settings = of.it
    inertia, weight, its = _carried(joint, settings)
    reaching = [_effort(drive) / math.sqrt(_carried(drive.joint, settings)[0]) for drive in settings.drives]
    own = [drive for drive in settings.drives if drive.joint == joint]
    strokes = dict(settings.strokes)
    travel = max((strokes[drive.axis] for drive in own if drive.axis in strokes), default=0.0)
    return Size(
        effort=max(math.sqrt(inertia) * max(reaching, default=0.0), weight),
        inertia=inertia,
        travel=max(travel, TURN if its.kind == "revolute" else 1.0),
        period_s=settings.sample_period_s,
        command=max((drive.limit for drive in own), default=0.0),
    )


def _effort(drive: Drive) -> float:
    return abs(drive.constant * drive.ratio * drive.limit)


def _carried(name: str, settings: PlantSettings) -> tuple[float, float, Joint]:
    """Return a joint with what moves with it [kg m^2 or kg] and the effort that its weight asks for, at most over all poses."""
    bodies = {body.name: body for body in settings.tree.bodies}
    carrier = next(body for body in settings.tree.bodies if body.joint is not None and body.joint.name == name)
    assert carrier.joint is not None
    mass = moment = inertia = 0.0
    for body, distance in _behind(carrier, bodies):
        arm = distance + float(np.linalg.norm(body.center_of_mass_m))
        mass += body.mass_kg
        moment += body.mass_kg * arm
        inertia += body.mass_kg * arm**2 + float(np.linalg.eigvalsh(body.inertia_kg_m2)[-1])
    gravity = float(np.linalg.norm(settings.tree.gravity_m_s2))
    if carrier.joint.kind == "revolute":
        return inertia + carrier.joint.armature, gravity * moment, carrier.joint
    return mass + carrier.joint.armature, gravity * mass, carrier.joint


def _behind(carrier: Body, bodies: dict[str, Body]) -> Iterator[tuple[Body, float]]:
    """Yield a body and all that hang on it, with the distance of their origins from its own, joints at zero and arms stretched out."""
    far = {carrier.name: 0.0}
    for name, body in bodies.items():
        if body.parent in far:
            far[name] = far[body.parent] + float(np.linalg.norm(body.position_m))
        if name in far:
            yield body, far[name]
