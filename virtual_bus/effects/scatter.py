"""What differs from run to run: the strengths of effects, drawn anew at every start of the emulated machine."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting

FARTHEST = 3.0  # standard deviations: a friction that turns negative is none


def drawn(settings: Iterable[EffectSetting], seed: int) -> tuple[EffectSetting, ...]:
    """Return the effects of one run.

    Every strength of an effect with scatter is multiplied by 1 + scatter times a normal number, kept within three deviations and the
    bounds of the catalogue. Each draws from its own stream, so a further effect changes no other.

    Parameters
    ----------
    settings : iterable of EffectSetting
        As the machine file or an effects file states them: the mean of all runs.
    seed : int
        Of the run.
    """
    return tuple(_drawn(setting, seed) if setting.scatter else setting for setting in settings)


def _drawn(setting: EffectSetting, seed: int) -> EffectSetting:
    values = dict(setting.parameters)
    for parameter in effects()[setting.name].parameters:
        if parameter.is_strength:
            stream = np.random.default_rng([seed, zlib.crc32(f"{setting.name} {setting.at} {parameter.name}".encode())])
            factor = 1.0 + setting.scatter * float(np.clip(stream.standard_normal(), -FARTHEST, FARTHEST))
            values[parameter.name] = min(max(values[parameter.name] * factor, parameter.low), parameter.high)
    return replace(setting, parameters=values, scatter=0.0)
