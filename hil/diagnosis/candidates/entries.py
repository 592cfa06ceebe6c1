"""The library: every law of every effect at every place, as columns beside the numbers' columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from hil.diagnosis.candidates.columns import Column, column
from hil.diagnosis.candidates.places import joint_of, place_of
from hil.diagnosis.residuals.trajectory import Motion, Signals, Trajectory
from virtual_bus.effects.bounds import effect_at
from virtual_bus.effects.effect import Effect, Parameter
from virtual_bus.effects.law import Law
from virtual_bus.effects.places import places
from virtual_bus.effects.registry import effects, module_of
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True, eq=False)
class Entry:
    """One law of one effect at one place."""

    effect: Effect
    at: str
    law: Law

    @property
    def width(self) -> int:
        """Number of weights."""
        return len(self.law.columns)

    @property
    def key(self) -> tuple[object, ...]:
        """What its columns are made of: laws with the same key have the same ones beside one machine."""
        return (self.effect.name, self.at, *(tuple(sorted(each.items())) for each in self.law.columns))

    def setting(self, weights: np.ndarray) -> EffectSetting:
        """Return the effect at these weights, its parameters within their bounds."""
        return setting_of(self.effect, self.at, self.law.parameters(weights))


def setting_of(effect: Effect, at: str, parameters: dict[str, float]) -> EffectSetting:
    """Return an effect with all its parameters, kept within their bounds."""
    values = {}
    for parameter in effect.parameters:
        value = parameters.get(parameter.name, parameter.neutral if parameter.default is None else parameter.default)
        values[parameter.name] = min(max(float(value), parameter.low), parameter.high)
    return EffectSetting(effect.name, at, values)


@cache
def effect_sought(name: str) -> Effect:
    """Return an effect with the bounds within which its parameters are sought; one that is not sought is a choice.

    They are the catalogue's own for machines of any size, as the search was measured, and not those of `virtual_bus.effects.bounds`.
    """
    effect = effects()[name]
    return replace(effect, parameters=tuple(_searched(parameter) for parameter in effect.parameters))


def _searched(parameter: Parameter) -> Parameter:
    if parameter.sought is None:
        return parameter
    low, high = max(parameter.low, parameter.sought[0]), min(parameter.high, parameter.sought[1])
    is_free = low < high
    return replace(parameter, low=low, high=high, fixed=not is_free, is_strength=parameter.is_strength and is_free)


def _is_sought(effect: Effect, law: Law) -> bool:
    """Return whether a law keeps to the bounds within which the parameters are sought."""
    narrow = [parameter for parameter in effect.parameters if parameter.sought is not None]
    return all(p.low <= column.get(p.name, p.low) <= p.high for column in law.columns for p in narrow)


def different_places(effect: Effect, trajectory: Trajectory, is_whole: bool = False) -> list[str]:
    """Return the places of an effect, each joint once: an axis and the body that its joint carries are the same place.

    They are all that the catalogue has, or those where it is sought along the motion.

    Where the effect is known already, and acts but once at a place, it is not sought.
    """
    found: dict[object, str] = {}
    bodies = {body.name for body in trajectory.settings.tree.bodies}

    def place(at: str) -> object:
        joint = joint_of(effect, at, trajectory)
        is_joint = joint is not None and (at in bodies or any(drive.axis == at for drive in trajectory.settings.drives))
        return joint if is_joint else at

    if effect.is_slow or (effect.kind.before_current and trajectory.observed.are_measured.all()):
        return []
    for at in places(effect.kind, trajectory.settings, None if is_whole else effect.sought_at):
        found.setdefault(place(at), at)
    if not effect.several:
        for one in trajectory.known:
            if one.name == effect.name:
                found.pop(place(one.at), None)
    return list(found.values())


def entries(
    trajectories: Sequence[Trajectory], motions: Sequence[Motion], nominal: Sequence[Signals], values: np.ndarray,
    missing: Sequence[np.ndarray], inertias: np.ndarray, is_whole: bool = False, everywhere: bool = False,
) -> Iterator[Entry]:  # fmt: skip
    """Yield the laws of all effects at all places.

    Parameters
    ----------
    nominal : sequence of Signals
        Along these motions with these values, and no effect but such as change numbers of joints.
    is_whole : bool
        Whether of the whole catalogue, in the bounds of a machine of this size; `everywhere`, at all its places, in the usual bounds.
    """
    for name, effect in effects().items():
        for at in different_places(effect, trajectories[0], is_whole or everywhere):
            place = place_of(effect, at, trajectories, motions, nominal, missing, inertias)
            if is_whole:
                own = effect_at(name, at, trajectories[0].settings)
                yield from (Entry(own, at, law) for law in module_of(name).laws(place))
                continue
            own = effect_sought(name)
            for law in module_of(name).laws(place):
                if _is_sought(own, law):
                    yield Entry(own, at, law)


def columns_of(
    entry: Entry, trajectories: Sequence[Trajectory], motions: Sequence[Motion], nominal: Sequence[Signals], values: np.ndarray,
    others: Sequence[EffectSetting] = (),
) -> list[list[Column]]:  # fmt: skip
    """Return what a law changes, for every recording one column a weight; none where it changes nothing or the machine cannot take it.

    `nominal` are the machine's signals with the effects `others`.
    """
    columns: list[list[Column]] = [[] for _ in trajectories]
    try:
        for parameters in entry.law.columns:
            one = (setting_of(entry.effect, entry.at, dict(parameters)),)
            for own, trajectory, motion, without in zip(columns, trajectories, motions, nominal, strict=True):
                both = (*others, *one)
                own.append(column(without, trajectory.signals(motion, trajectory.model(values, both), both, nearby=without)))
    except EffectError:
        return []
    return columns if any(each.efforts or each.readings for own in columns for each in own) else []


def moved(
    settings: Sequence[EffectSetting], parameters: Sequence[tuple[int, Parameter]], steps: Sequence[float] | np.ndarray,
    bounded: Sequence[Effect] | None = None,
) -> tuple[EffectSetting, ...]:  # fmt: skip
    """Return effects of which some parameters are larger by these steps, within their bounds, or those of other entries of them."""
    bounded = bounded or [effect_sought(setting.name) for setting in settings]
    changes: list[dict[str, float]] = [{} for _ in settings]
    for (k, parameter), by in zip(parameters, steps, strict=True):
        changes[k][parameter.name] = settings[k].parameters[parameter.name] + float(by)
    changed = zip(bounded, settings, changes, strict=True)
    return tuple(setting_of(entry, setting.at, {**setting.parameters, **change}) for entry, setting, change in changed)


def free_parameters(settings: Sequence[EffectSetting]) -> tuple[tuple[int, Parameter], ...]:
    """Return the parameters of effects that are fitted, each with its effect's number.

    A strength that a law leaves at its neutral value stays there, unless all do.
    """
    found: list[tuple[int, Parameter]] = []
    for k, setting in enumerate(settings):
        parameters = [parameter for parameter in effect_sought(setting.name).parameters if not parameter.fixed]
        acting = {one.name for one in parameters if one.is_strength and setting.parameters[one.name] != one.neutral}
        found += [(k, one) for one in parameters if not (acting and one.is_strength) or one.name in acting]
    return tuple(found)
