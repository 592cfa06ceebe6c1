"""Which effects of a machine a linear model holds, and which it leaves out, with the reason."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True)
class LeftOut:
    """An effect of a machine that a linear model of it does not hold, or not wholly."""

    name: str
    """Of the effect."""
    at: str
    """Its place."""
    why: str
    """Why it is left out."""


def left_out(settings: Iterable[EffectSetting]) -> tuple[LeftOut, ...]:
    """Return the effects that a linear model leaves out, or of which it leaves out a part, in their own order."""
    found = []
    for setting in settings:
        effect = effects()[setting.name]
        if effect.left_out and _linear_part(setting) != setting:
            found.append(LeftOut(setting.name, setting.at, effect.left_out))
    return tuple(found)


def sentences(found: Iterable[LeftOut]) -> list[str]:
    """Return a sentence per effect: its places, and why it is left out."""
    places: dict[tuple[str, str], list[str]] = {}
    for each in found:
        places.setdefault((each.name, each.why), []).append(each.at)
    return [f"{name} at {', '.join(at)}: {why}" for (name, why), at in places.items()]


def without(settings: Iterable[EffectSetting]) -> str:
    """Return the end of a linear answer's text: "; without NAME, NAME", the effects that it does not hold; "" where it holds all."""
    names = list(dict.fromkeys(each.name for each in left_out(settings)))
    return f"; without {', '.join(names)}" if names else ""


def linear_parts(settings: Iterable[EffectSetting]) -> tuple[EffectSetting, ...]:
    """Return what a linear model holds of these effects."""
    parts = (_linear_part(setting) for setting in settings)
    return tuple(part for part in parts if part is not None)


def _linear_part(setting: EffectSetting) -> EffectSetting | None:
    """Return an effect with the parameters at neutral that a linear model does not know; None of one that it leaves out."""
    effect = effects()[setting.name]
    strengths = [each for each in effect.parameters if each.is_strength]
    is_nothing = all(setting.parameters.get(each.name, each.default) == each.neutral for each in strengths)
    if is_nothing or not effect.left_out:
        return setting
    if not effect.left_out_of:
        return None
    neutral = {each.name: each.neutral for each in effect.parameters if each.name in effect.left_out_of}
    return replace(setting, parameters={**setting.parameters, **neutral})
