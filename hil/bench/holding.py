"""The greatest effort with which a drive holds each axis of a machine: one that goes on with more pushes."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from drivers.canopen.brake_proof import PUSH_SHARE
from drivers.settings import BusSettings, MotionLimits
from hil.machine import Machine
from hil.machine.drawn import ends, spans
from virtual_bus.effects.effect import BODY_CHANGE, CHANGE, EFFORT, PHASE
from virtual_bus.effects.motion import JointMotion
from virtual_bus.effects.registry import effects, module_of
from virtual_bus.effects.table import values_of, with_hook
from virtual_bus.physics import Physics
from virtual_bus.plant.statics import effort_at, equilibrium
from virtual_bus.settings import EffectSetting

POSITIONS = 9
"""Of each axis at which its load is looked at: over a whole turn, steps of 45 degrees miss 8 % of the greatest load."""
MOST_POSES = POSITIONS**3
"""Of machines with more axes no effort is judged: at 8 % an axis, four of them would miss more than the quarter that is added."""
TURN = 2.0 * math.pi
QUARTERS = (0.0, 0.5 * math.pi, math.pi)
ORDER = "cycles/turn"

_known: dict[str, np.ndarray] = {}
"""Greatest loads by plant and positions: they take a tenth of a second, and each bench that is opened asks for them."""


def with_holding_efforts(machine: Machine, model: Physics) -> Machine:
    """Return a machine whose drives and supervisor know how much effort a hold takes at most.

    An axis that stands free takes its load, less or more of its dry friction. The load is that of the pose with the greatest one, as great
    as the ranges of the file's effects let it be, and the share of it by which a proof of the brake exceeds it. The friction is less than
    the first move's push, with which every start shows that the axis moves. What the drive's own measurement is off by comes on top. More
    than the drive can give is no limit.

    Parameters
    ----------
    machine : Machine
        With a bus.
    model : Physics
        Of the machine file.
    """
    bus = machine.bus
    assert bus is not None
    efforts = _greatest(machine, model, bus)
    motions = tuple(dataclasses.replace(limits, holding_effort=each) for limits, each in zip(bus.motions, efforts, strict=True))
    return dataclasses.replace(machine, bus=dataclasses.replace(bus, motions=motions))


def _greatest(machine: Machine, model: Physics, bus: BusSettings) -> tuple[float, ...]:
    friction = np.array([homing.direction_check_effort for homing in bus.homings])
    off = np.array([judged.tolerance for judged in machine.judging.drives])
    efforts = (1.0 + PUSH_SHARE) * _greatest_loads(machine, model, bus) + friction + off
    limits = [scaling.limit for scaling in bus.scalings]
    return tuple(float(effort) if effort < limit else math.inf for effort, limit in zip(efforts, limits, strict=True))


def _greatest_loads(machine: Machine, model: Physics, bus: BusSettings) -> np.ndarray:
    """Return the greatest load (n_axes,) of each axis of all poses that are looked at; infinite where these would be too many."""
    ways = [_positions(limits, scaling.position_unit) for limits, scaling in zip(bus.motions, bus.scalings, strict=True)]
    if math.prod(map(len, ways)) > MOST_POSES:
        return np.full(len(ways), math.inf)
    key = repr((machine.plant, ways))
    if key not in _known:
        loads, poses = Loads(machine, model), [np.array(pose) for pose in itertools.product(*ways)]
        held = [np.abs(model.holding_effort(pose)[:, None] + loads.between(pose)).max(axis=1) for pose in poses]
        _known[key] = np.max(held, axis=0)
    return _known[key]


class Loads:
    """By how much what holds a sound machine may differ from what holds the model of its file.

    Each effect of the file that pulls, or changes masses or what a drive's effort makes, is looked at over its ranges, the others as they
    are; their loads add up. How the structure bends is left out. Friction is none of them: it holds an axis too, and opposes what moves it.

    Parameters
    ----------
    machine : Machine
    model : Physics
        Of the machine file.
    """

    def __init__(self, machine: Machine, model: Physics) -> None:
        own, added = machine.own_effects, machine.added_effects
        self._model, record = model, model.model
        self._changed = [
            [model.plant.model(effects=(*own[:number], each, *own[number + 1 :], *added)) for each in ends(effect)]
            for number, effect in enumerate(own)
            if effect.between and effects()[effect.name].kind in (CHANGE, BODY_CHANGE)
        ]
        axes = {joint: axis for axis, joint in enumerate(model.plant.driven_joints.tolist())}
        joints, ratios = record["effort_joint"][0].tolist(), record["effort_ratio"][0].tolist()
        self._pulls = [
            (axes[joint], joint, _Pull(effect, ratio))
            for effect, joint, ratio in zip(with_hook((*own, *added), EFFORT.function), joints, ratios, strict=False)
            if effect.between and effects()[effect.name].kind is EFFORT and joint in axes
        ]

    def between(self, pose: np.ndarray) -> np.ndarray:
        """Return the least and the most effort (n_axes, 2) beside the model's at a pose (n_axes,), in the drives' units."""
        if not (self._changed or self._pulls):
            return np.zeros((len(pose), 2))
        return self.between_at(equilibrium(self._model.plant, self._model.model, pose))

    def between_at(self, joints: np.ndarray) -> np.ndarray:
        """Return the same at joint positions (n,)."""
        if not (self._changed or self._pulls):
            return np.zeros((len(self._model.plant.driven_joints), 2))
        plant, own = self._model.plant, self._model.model
        between, pulls = np.zeros((2, len(plant.driven_joints), 2))
        stated = effort_at(plant, own, joints)
        for axis, joint, pull in self._pulls:
            pulls[axis] += pull.between(float(joints[joint]))
        ways = [[effort_at(plant, each, joints) for each in changed] for changed in self._changed]
        for efforts in (*ways, [effort_at(plant, own, joints, each) for each in pulls.T]):
            between[:, 0] += np.min(efforts - stated, axis=0, initial=0.0)
            between[:, 1] += np.max(efforts - stated, axis=0, initial=0.0)
        return between


class _Pull:
    """An effect's effort on a joint at rest, at the ends of its ranges; a phase also where the effort is greatest and least over it.

    An effort is a constant, a sine and a cosine of each of its phases, which three values of it tell. An order that is open leaves every
    phase open, as it is multiplied with the position.
    """

    def __init__(self, effect: EffectSetting, ratio: float) -> None:
        self._law, self._ratio, self._stated = module_of(effect.name).effort, ratio, values_of(effect)
        self._ends = [values_of(each) for each in ends(effect)]
        units, open_ = {each.name: each.unit for each in effects()[effect.name].parameters}, spans(effect)
        if any(units[name] == ORDER for name in open_):
            open_ |= {name: [(-math.pi, math.pi)] for name, unit in units.items() if unit == PHASE}
        self._phases = [(number, open_[name]) for number, (name, unit) in enumerate(units.items()) if unit == PHASE and name in open_]

    def between(self, position: float) -> tuple[float, float]:
        """Return the least and the greatest effort beside the stated one, with the joint at this position."""
        motion = JointMotion(position, 0.0, -1.0, self._ratio, 0.0, 0.0)
        efforts = [self._law(motion, *each) for values in self._ends for each in self._looked_at(motion, values)]
        stated = self._law(motion, *self._stated)
        return min(efforts) - stated, max(efforts) - stated

    def _looked_at(self, motion: JointMotion, values: list[float]) -> Iterator[tuple[float, ...]]:
        """Yield these parameters with every combination of their phases that may give the least or the greatest effort."""
        ways = [[value] for value in values]
        for number, ranges in self._phases:
            ahead, across, behind = (self._law(motion, *values[:number], phase, *values[number + 1 :]) for phase in QUARTERS)
            middle = 0.5 * (ahead + behind)
            crest = math.atan2(across - middle, ahead - middle)
            turned = [crest + turns * math.pi for turns in range(-3, 4)]  # phases are within a turn of zero
            ways[number] = [phase for low, high in ranges for phase in (low, high, *(each for each in turned if low < each < high))]
        yield from itertools.product(*ways)


def _positions(limits: MotionLimits, unit: str) -> np.ndarray:
    """Return positions (n,) over the range of an axis [rad or m], or over a turn of one that turns further."""
    if not (math.isfinite(limits.lower) and math.isfinite(limits.upper)):
        return np.linspace(-math.pi, math.pi, POSITIONS)
    return np.linspace(limits.lower, min(limits.upper, limits.lower + TURN) if unit == "rad" else limits.upper, POSITIONS)
