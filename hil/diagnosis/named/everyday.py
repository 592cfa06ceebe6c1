"""The engineer's first fit: numbers, and the everyday effects at every driven joint."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.candidates.entries import different_places, setting_of
from hil.diagnosis.seen.along import Along
from hil.diagnosis.tuned.retuning import Known
from virtual_bus.effects.effect import FRICTION
from virtual_bus.effects.motion import JointState
from virtual_bus.effects.places import joint_at
from virtual_bus.effects.registry import effects, module_of
from virtual_bus.settings import EffectSetting


def everyday_effects(along: Along) -> tuple[EffectSetting, ...]:
    """Return all everyday effects at all axes, without strength."""
    axes = {drive.axis for drive in along.settings.drives}
    return tuple(
        setting_of(effect, at, {})
        for effect in effects().values()
        if effect.everyday
        for at in different_places(effect, along)
        if at in axes
    )


def known_of(along: Along, settings: tuple[EffectSetting, ...]) -> Known | None:
    """Return what a set of effects, and those that are known, say of friction; None where there are none."""
    if not settings and not along.known:
        return None
    dry = np.zeros(len(along.joints))
    for setting in (*along.known, *settings):
        if effects()[setting.name].kind is FRICTION:
            dry[along.joints.index(joint_at(setting.at, along.settings))] += _at_rest(setting)
    return Known(settings, dry)


def _at_rest(setting: EffectSetting) -> float:
    """Return the level [Nm or N] that a friction law has at rest, without load."""
    arguments = [setting.parameters[parameter.name] for parameter in effects()[setting.name].parameters]
    return float(module_of(setting.name).level(JointState(0.0, 1.0, 0.0, 0.0), *arguments))
