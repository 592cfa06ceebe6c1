"""What differs from run to run: the strengths of effects, drawn anew at every start of the emulated machine."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from virtual_bus.effects.bounds import effect_at
from virtual_bus.settings import EffectSetting, PlantSettings

FARTHEST = 3.0  # standard deviations: a friction that turns negative is none


def drawn(chosen: Iterable[EffectSetting], seed: int, settings: PlantSettings) -> tuple[EffectSetting, ...]:
    """Return the effects of one run.

    Every strength of an effect with scatter is multiplied by 1 + scatter times a normal number, kept within three deviations and the
    bounds of the machine. Each draws from its own stream, so a further effect changes no other.

    Parameters
    ----------
    chosen : iterable of EffectSetting
        As the machine file or an effects file states them: the mean of all runs.
    seed : int
        Of the run.
    settings : PlantSettings
        The machine that has them.
    """
    return tuple(_drawn(setting, seed, settings) if setting.scatter else setting for setting in chosen)


def _drawn(setting: EffectSetting, seed: int, settings: PlantSettings) -> EffectSetting:
    values = dict(setting.parameters)
    for parameter in effect_at(setting.name, setting.at, settings).parameters:
        if parameter.is_strength:
            stream = np.random.default_rng([seed, zlib.crc32(f"{setting.name} {setting.at} {parameter.name}".encode())])
            factor = 1.0 + setting.scatter * float(np.clip(stream.standard_normal(), -FARTHEST, FARTHEST))
            values[parameter.name] = min(max(values[parameter.name] * factor, parameter.low), parameter.high)
    return replace(setting, parameters=values, scatter=0.0)
