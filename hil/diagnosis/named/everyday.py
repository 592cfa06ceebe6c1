"""The engineer's first fit: numbers, and the everyday effects at every driven joint."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.library.entries import different_places, setting_of
from hil.diagnosis.named.fitting import Fitted, fit
from hil.diagnosis.tuned.retuning import Known, Tuned
from virtual_bus.effects.effect import FRICTION
from virtual_bus.effects.motion import JointState
from virtual_bus.effects.places import joint_at
from virtual_bus.effects.registry import effects, module_of
from virtual_bus.settings import EffectSetting


def everyday_fit(tuned: Tuned) -> Fitted:
    """Return the fit of all everyday effects at all axes together."""
    along = tuned.looked[0].beside.along
    axes = {drive.axis for drive in along.settings.drives}
    settings = [
        setting_of(effect, at, {})
        for effect in effects().values()
        if effect.everyday
        for at in different_places(effect, along)
        if at in axes
    ]
    found = fit(tuned, settings)
    assert found is not None
    return found


def known_of(tuned: Tuned, fitted: Fitted) -> Known:
    """Return what a fitted set says of friction."""
    along = tuned.looked[0].beside.along
    dry = np.zeros(len(along.joints))
    for setting in fitted.settings:
        if effects()[setting.name].kind is FRICTION:
            dry[along.joints.index(joint_at(setting.at, along.settings))] += _at_rest(setting)
    return Known(fitted.settings, dry)


def _at_rest(setting: EffectSetting) -> float:
    """Return the level [Nm or N] that a friction law has at rest, without load."""
    arguments = [setting.parameters[parameter.name] for parameter in effects()[setting.name].parameters]
    return float(module_of(setting.name).level(JointState(0.0, 1.0, 0.0, 0.0), *arguments))
