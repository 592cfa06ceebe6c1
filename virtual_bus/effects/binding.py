"""Effects by name, checked against the catalogue and bound to the places of a machine."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeGuard

from virtual_bus.effects.bounds import effect_at
from virtual_bus.effects.effect import Effect, Parameter
from virtual_bus.effects.places import drive_unit, is_prismatic, places
from virtual_bus.effects.registry import effects
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting, PlantSettings

SCATTER = "scatter_percent"
MOST_SCATTER_percent = 100.0
BETWEEN = "_between"
"""Behind a parameter's key: the range in which it lies on one machine or another of this kind."""
RESERVED = ("name", "at", SCATTER)
NEEDS = {"": "", "spring": " with a sprung joint", "neighbour": " beside another axis"}


def bind_effects(entries: Sequence[Mapping[str, object]], settings: PlantSettings, where: str = "effects") -> tuple[EffectSetting, ...]:
    """Bind the effects of an effects file to one machine."""
    bound: dict[tuple[object, ...], EffectSetting] = {}
    for number, entry in enumerate(entries, start=1):
        setting = _bind(entry, settings, f"{where}: effect {number}")
        if _which(setting) in bound:
            raise EffectError(f"{where}: effect {number}: {setting.name} at {setting.at!r} is given twice; once is enough")
        bound[_which(setting)] = setting
    return tuple(bound.values())


def check_apart(bound: Iterable[EffectSetting], own: Sequence[EffectSetting], where: str) -> None:
    """Raise EffectError where an effect is one that the machine file states already."""
    stated = {_which(setting) for setting in own}
    for setting in bound:
        if _which(setting) in stated:
            raise EffectError(f"{where}: {setting.name} at {setting.at!r} is in the machine file already; leave it out, or change it there")


def _which(setting: EffectSetting) -> tuple[object, ...]:
    """Return what two settings share that are one effect at one place.

    Of effects that may act there several times, only those with the same value of the parameter `several` names are one.
    """
    apart = effects()[setting.name].several
    return setting.name, setting.at, setting.parameters[apart] if apart else None


def as_entries(bound: Iterable[EffectSetting], settings: PlantSettings) -> list[dict[str, object]]:
    """Return bound effects as an effects file writes them: the inverse of `bind_effects`."""
    entries: list[dict[str, object]] = []
    for setting in bound:
        keys = {parameter.name: key for key, (parameter, _) in _keys(effects()[setting.name], setting.at, settings).items()}
        numbers = {keys[name]: value for name, value in setting.parameters.items()}
        scatter = {SCATTER: 100.0 * setting.scatter} if setting.scatter else {}
        ranges = {f"{keys[name]}{BETWEEN}": list(ends) for name, ends in setting.between.items()}
        entries.append({"name": setting.name, "at": setting.at, **numbers, **scatter, **ranges})
    return entries


def _bind(entry: Mapping[str, object], settings: PlantSettings, where: str) -> EffectSetting:
    name = entry.get("name")
    known = effects()
    if not isinstance(name, str) or name not in known:
        hint = difflib.get_close_matches(str(name), known, n=1) if name is not None else []
        advice = f"did you mean {hint[0]}?" if hint else _listed("there is", known)
        raise EffectError(f"{where}: name = {name!r}: no such effect; {advice}")
    effect = known[name]
    at = entry.get("at")
    allowed = places(effect.kind, settings)
    if at not in allowed:
        kinds = " or ".join(effect.kind.allowed_at) + NEEDS[effect.kind.needs]
        there = _listed("there is", allowed) if allowed else f"this machine has none: {_listed('its axes are', _axes(settings))}"
        raise EffectError(f"{where}: {name}: at = {at!r}: acts at an {kinds} of the machine; {there}")
    assert isinstance(at, str)
    where = f"{where}: {name} at {at!r}"
    keys = _keys(effect_at(name, at, settings), at, settings)
    return EffectSetting(name, at, _parameters(entry, keys, where), _scatter(entry, where), _between(entry, keys, where))


def _scatter(entry: Mapping[str, object], where: str) -> float:
    value = entry.get(SCATTER, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= MOST_SCATTER_percent:
        raise EffectError(f"{where}: {SCATTER} = {value!r}: must be a number from 0 to {MOST_SCATTER_percent:g}")
    return float(value) / 100.0


def _between(entry: Mapping[str, object], keys: Mapping[str, tuple[Parameter, str]], where: str) -> dict[str, tuple[float, float]]:
    ranges = {}
    for key, (parameter, unit) in keys.items():
        ends = entry.get(f"{key}{BETWEEN}")
        if ends is None:
            continue
        low, high = ends if isinstance(ends, list | tuple) and len(ends) == 2 else (None, None)
        if not (_is_number(low) and _is_number(high) and parameter.low <= low < high <= parameter.high):
            bounds = f"{parameter.low:g} to {parameter.high:g} {unit}".rstrip()
            raise EffectError(f"{where}: {key}{BETWEEN} = {ends!r}: must be [least, most], numbers from {bounds}, the least first")
        ranges[parameter.name] = float(low), float(high)
    return ranges


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _keys(effect: Effect, at: str, settings: PlantSettings) -> dict[str, tuple[Parameter, str]]:
    """Return parameter and unit by the key that an effects file writes at this place."""
    prismatic, unit = is_prismatic(at, settings), drive_unit(at, settings)
    return {parameter.key(prismatic, unit): (parameter, parameter.unit_at(prismatic, unit)) for parameter in effect.parameters}


def _parameters(entry: Mapping[str, object], keys: Mapping[str, tuple[Parameter, str]], where: str) -> dict[str, float]:
    for key in entry:
        if key.removesuffix(BETWEEN) not in keys and key not in RESERVED:
            raise EffectError(f"{where}: no parameter {key!r}; {_listed('it takes', keys)}")
    values = {}
    for key, (parameter, unit) in keys.items():
        if key not in entry and parameter.default is None:
            raise EffectError(f"{where}: {key} is missing: {parameter.description}")
        value = entry.get(key, parameter.default)
        if not _is_number(value) or not parameter.low <= value <= parameter.high:
            bounds = f"{parameter.low:g} to {parameter.high:g} {unit}".rstrip()
            raise EffectError(f"{where}: {key} = {value!r}: must be a number from {bounds}")
        values[parameter.name] = float(value)
    return values


def _axes(settings: PlantSettings) -> list[str]:
    return [drive.axis for drive in settings.drives]


def _listed(phrase: str, names: Iterable[str]) -> str:
    return f"{phrase} {', '.join(names)}"
