"""One list of unknowns: numbers of the file, of the controller's side and of sensors, in coordinates of what is known beforehand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from hil.diagnosis.candidates.entries import moved
from virtual_bus.effects.bounds import effect_at
from virtual_bus.effects.effect import PHASE, Parameter
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.rigid_bodies import RigidBodies, rigid_bodies
from virtual_bus.settings import EffectSetting, PlantSettings

TOLERANCE = 0.15
"""Standard deviation of a number of the machine file, as a share of it, where the file states none."""
CLOCKED_TOLERANCE = 0.02
"""Of corners that a sensor's clock makes: data sheets say 1 to 3 %."""
CLOCKED = ("accelerometer_bandwidth", "gyro_bandwidth")
POSITIVE = ("mass", "stiffness", "damping", "armature", "constant", *CLOCKED)
SIGNED = ("center_of_mass",)
FREED = (*POSITIVE, *SIGNED, "inertia")
FURTHEST = 30.0
"""Factor by which a number of the file may be wrong at most: more is another machine's."""
ROTOR = 0.1
"""Standard deviation of a rotor's inertia that the file leaves out, as a share of what moves with its joint."""
STEP = 1e-3
"""Of a difference, in standard deviations of a number or as a share of a parameter."""
PHASE_STEP = 1e-3
"""Of a phase [rad]."""


class Kind(Enum):
    """What an unknown is of."""

    NUMBER = "number"
    GAIN = "gain"
    LATENESS = "lateness"
    ZERO = "zero"
    EFFORT_ZERO = "effort_zero"
    EFFORT_LAG = "effort_lag"
    SPEED_LIMIT = "speed_limit"
    EARLY = "early"


@dataclass(frozen=True)
class Unknown:
    """A number that a fit may change.

    Attributes
    ----------
    name : str
        As in findings and in the re-tuned machine file.
    kind : Kind
    place : int
        Of a number: among the plant's parameters; of a gain: its axis; of a zero: its channel.
    nominal : float
        What the file says.
    scale : float
        One standard deviation: of its logarithm where `is_log`, else in its unit.
    is_log : bool
        Whether it keeps its sign.
    recording : int or None
        The recording that it is of; None: of all.
    is_left_out : bool
        Whether it is none in the file, and not negative.
    most : float
        Largest value.
    """

    name: str
    kind: Kind
    place: int
    nominal: float
    scale: float
    is_log: bool = False
    recording: int | None = None
    is_left_out: bool = False
    most: float = math.inf

    def value(self, coordinate: float) -> float:
        """Return the number at a coordinate [standard deviations]."""
        if self.is_log:
            return self.nominal * math.exp(coordinate * self.scale)
        return self.nominal + coordinate * self.scale

    @property
    def furthest(self) -> float:
        """Largest coordinate."""
        return math.log(FURTHEST) / abs(self.scale) if self.is_log else min(FURTHEST, (self.most - self.nominal) / self.scale)


@dataclass(frozen=True, eq=False)
class Machine:
    """One machine to simulate.

    Attributes
    ----------
    values : (parameters,) array
        Of the plant.
    effects : tuple of EffectSetting
    gain : (axes,) array
        Of the controllers, in units of the file's.
    early : (axes,) array
        Shares of a row by which controllers' commands act before the next row.
    lateness_s : float
        By how much efforts, or references, act later than they were recorded.
    zeros : mapping of (int, int) to float
        By recording and channel: what a sensor reads too much.
    effort_zero, effort_lag_s : mapping of int to float
        By axis: what its measured effort is too large by, and the time constant that it follows the effort with.
    speed_limit : tuple of (int, float)
        Axes, and the largest speed that their references are followed with.
    """

    values: np.ndarray
    effects: tuple[EffectSetting, ...]
    gain: np.ndarray
    early: np.ndarray
    lateness_s: float = 0.0
    zeros: dict[tuple[int, int], float] = field(default_factory=dict)
    effort_zero: dict[int, float] = field(default_factory=dict)
    effort_lag_s: dict[int, float] = field(default_factory=dict)
    speed_limit: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The unknowns of a machine besides its effects' parameters.

    Attributes
    ----------
    plant : CompiledPlant
    each : tuple of Unknown
    bodies : RigidBodies
    """

    plant: CompiledPlant
    each: tuple[Unknown, ...]
    bodies: RigidBodies

    def machine(self, point: Point) -> Machine:
        """Return the machine at a point."""
        values = self.plant.nominal
        axes = len(self.plant.settings.drives)
        gain, early = np.ones(axes), np.zeros(axes)
        lateness = 0.0
        zeros: dict[tuple[int, int], float] = {}
        effort_zero: dict[int, float] = {}
        effort_lag: dict[int, float] = {}
        limits: list[tuple[int, float]] = []
        for unknown, coordinate in zip(self.each, point.numbers.tolist(), strict=True):
            value = unknown.value(coordinate)
            if unknown.kind is Kind.NUMBER:
                values[unknown.place] = value
            elif unknown.kind is Kind.GAIN:
                gain[unknown.place] = value
            elif unknown.kind is Kind.EARLY:
                early[unknown.place] = value
            elif unknown.kind is Kind.LATENESS:
                lateness = value
            elif unknown.kind is Kind.EFFORT_ZERO:
                effort_zero[unknown.place] = value
            elif unknown.kind is Kind.SPEED_LIMIT:
                limits += [(unknown.place, value)] if value < unknown.nominal else []  # none is known above what was recorded
            elif unknown.kind is Kind.EFFORT_LAG:
                effort_lag[unknown.place] = max(value, 0.0)
            else:
                assert unknown.recording is not None
                zeros[unknown.recording, unknown.place] = value
        return Machine(self.bodies.rigid(values), point.settings, gain, early, lateness, zeros, effort_zero, effort_lag, tuple(limits))

    def start(self, settings: Sequence[EffectSetting] = ()) -> Point:
        """Return the file's machine with some effects."""
        return Point(np.zeros(len(self.each)), tuple(settings), self.plant.settings)


@dataclass(frozen=True, eq=False)
class Point:
    """Where the unknowns are.

    Attributes
    ----------
    numbers : (P,) array
        Coordinates of the unknowns.
    settings : tuple of EffectSetting
    of : PlantSettings
        The machine: its size bounds effects' parameters.
    held : frozenset of int
        Unknowns that stay where they are.
    """

    numbers: np.ndarray
    settings: tuple[EffectSetting, ...]
    of: PlantSettings
    held: frozenset[int] = frozenset()

    @property
    def names(self) -> frozenset[tuple[str, str]]:
        """Effects and places."""
        return frozenset((each.name, each.at) for each in self.settings)

    @property
    def parameters(self) -> list[tuple[int, Parameter]]:
        """Free parameters of the effects: which one's each is.

        A strength that stands at its neutral value is free as well: a second harmonic begins there.
        """
        found = []
        for k, setting in enumerate(self.settings):
            own = effect_at(setting.name, setting.at, self.of).parameters
            found += [(k, parameter) for parameter in own if not parameter.fixed]
        return found

    @property
    def bounded(self) -> list[tuple[float, Parameter]]:
        """Values of the free parameters of the effects."""
        return [(self.settings[k].parameters[parameter.name], parameter) for k, parameter in self.parameters]

    @property
    def free(self) -> list[int]:
        """Unknowns that move."""
        return [k for k in range(len(self.numbers)) if k not in self.held]

    @property
    def coordinates(self) -> np.ndarray:
        """Free unknowns and parameters (free + Q,)."""
        return np.append(self.numbers[self.free], [self.settings[k].parameters[parameter.name] for k, parameter in self.parameters])

    def steps(self) -> np.ndarray:
        """Return the steps of differences (free + Q,), of unknowns and then of parameters."""
        found = [STEP] * len(self.free)
        for k, parameter in self.parameters:
            value = self.settings[k].parameters[parameter.name]
            usual = STEP * abs(value) if value else parameter.small
            step = PHASE_STEP if parameter.unit == PHASE else usual
            found.append(-step if value + step > parameter.high else step)
        return np.array(found)

    def moved(self, step: np.ndarray) -> Point:
        """Return the point a step (free + Q,) away, parameters kept within their bounds."""
        free = self.free
        numbers = self.numbers.copy()
        numbers[free] += step[: len(free)]
        bounded = [effect_at(setting.name, setting.at, self.of) for setting in self.settings]
        return replace(self, numbers=numbers, settings=moved(self.settings, self.parameters, step[len(free) :], bounded))

    def room(self, unknowns: Unknowns, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Return how far down and up a step (free + Q,) may go; parameters by a share `reach` of them."""
        free = self.free
        furthest = np.array([unknowns.each[k].furthest for k in free]).reshape(-1)
        at = self.numbers[free]
        lowest = np.array([0.0 if unknowns.each[k].is_left_out else -unknowns.each[k].furthest for k in free]).reshape(-1)
        low, high = list(lowest - at), list(furthest - at)
        for k, parameter in self.parameters:
            value = self.settings[k].parameters[parameter.name]
            most = np.inf
            if parameter.unit == PHASE:
                most = reach
            elif value != 0.0:
                most = reach * abs(value) if not parameter.is_strength else np.inf
            elif not parameter.is_strength:
                most = parameter.small
            low.append(max(parameter.low - value, -most))
            high.append(min(parameter.high - value, most))
        return np.array(low), np.array(high)


def numbers_of(plant: CompiledPlant) -> Unknowns:
    """Return the numbers of a machine file that recordings may correct.

    Positive ones are known by a factor, within their tolerance: what lies far beyond it is found as well. Rotors' inertias that the file
    leaves out, and centres of mass, are known by a deviation.
    """
    found = []
    names = [joint.name for joint in plant.settings.tree.joints]
    driven = {drive.joint for drive in plant.settings.drives}
    moved = plant.inertias(plant.model(), np.zeros(len(names)))
    for i, parameter in enumerate(plant.parameters):
        name = f"{parameter.owner}.{parameter.quantity}"
        if parameter.tolerance == 0.0 or not (parameter.quantity.startswith(FREED) or parameter.tolerance is not None):
            continue
        if parameter.value > 0.0 and parameter.quantity.startswith((*POSITIVE, "inertia_xx", "inertia_yy", "inertia_zz")):
            usual = CLOCKED_TOLERANCE if parameter.quantity in CLOCKED else TOLERANCE
            share = usual if parameter.tolerance is None else parameter.tolerance / parameter.value
            found.append(Unknown(name, Kind.NUMBER, i, parameter.value, min(share, 1.0), is_log=True))
        elif parameter.value != 0.0 or parameter.tolerance is not None:
            scale = parameter.tolerance if parameter.tolerance is not None else TOLERANCE * abs(parameter.value)
            found.append(Unknown(name, Kind.NUMBER, i, parameter.value, scale))
        elif parameter.quantity.startswith("armature") and parameter.owner in driven:
            found.append(Unknown(name, Kind.NUMBER, i, 0.0, ROTOR * float(moved[names.index(parameter.owner)]), is_left_out=True))
    return Unknowns(plant, tuple(found), rigid_bodies(plant.parameters))
