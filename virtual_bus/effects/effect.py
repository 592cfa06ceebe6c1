"""What an effect is: a piece of physics with a name, parameters and a place, added to a machine by an effects file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

MAX_PARAMETERS = 8  # columns of a compiled effect table
PRISMATIC_UNITS = {"Nm": "N", "rad": "m", "rad/s": "m/s", "Nm/rad": "N/m", "Nm s/rad": "N s/m", "kg m2": "kg"}


class JointState(NamedTuple):
    """What a friction law may depend on, at the joint."""

    speed: float  # magnitude [rad/s or m/s]
    direction: float  # +1 or -1: of the motion, or of the motion that is about to begin
    position: float  # [rad or m]


@dataclass(frozen=True)
class EffectKind:
    """How effects of one kind enter the equations: the function an effect's file defines, and what it returns."""

    name: str
    function: str
    allowed_at: tuple[str, ...]  # "axis", "body", "sensor"
    description: str


FRICTION = EffectKind(
    name="friction",
    function="level",
    allowed_at=("axis",),
    description=(
        "level(state: JointState, *parameters) -> effort [Nm or N], not negative, that opposes the joint's motion; "
        "at rest, the most it holds"
    ),
)


@dataclass(frozen=True)
class Parameter:
    """One number of an effect, with the bounds a real machine keeps."""

    name: str
    unit: str  # at a revolute joint; PRISMATIC_UNITS has its counterpart at a prismatic one
    low: float
    high: float
    description: str

    def unit_at(self, prismatic: bool) -> str:
        """The unit at a joint that turns or one that slides."""
        return PRISMATIC_UNITS.get(self.unit, self.unit) if prismatic else self.unit

    def key(self, prismatic: bool = False) -> str:
        """As it is written in an effects file: `Fc_Nm`, `vs_rad_s`, `delta`."""
        suffix = self.unit_at(prismatic).replace("/", "_").replace(" ", "_")
        return f"{self.name}_{suffix}" if suffix else self.name


@dataclass(frozen=True)
class Effect:
    """One kind of physics by name. Its file is virtual_bus/effects/<name>.py and holds EFFECT and the kind's function."""

    name: str
    kind: EffectKind
    parameters: tuple[Parameter, ...]
    convention: str  # sign, half or full gap, which side of the gear
    neighbours: tuple[str, ...]  # what it is mistaken for
    source: str
