"""A machine with all forces scaled so that a drive's constant is what it was when the machine was seen.

Equations along the motion are linear there, and in forces: weaker drives on a lighter machine would leave less of everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.diagnosis.candidates.entries import moved
from hil.diagnosis.retuning.common_scale import CommonScale, common_scale
from hil.diagnosis.retuning.linear_model import LinearModel
from virtual_bus.effects.effect import Parameter, power_of_force
from virtual_bus.settings import EffectSetting


@dataclass(frozen=True, eq=False)
class Held:
    """Nuisances (P,) and effects of that machine, and the scale of forces; None where motions show it: then it is the machine itself."""

    offset: np.ndarray
    settings: tuple[EffectSetting, ...]
    scale: CommonScale | None


def held_at(
    linear: LinearModel, settings: tuple[EffectSetting, ...], offset: np.ndarray, parameters: Sequence[tuple[int, Parameter]]
) -> Held:
    """Return it, of the machine with these nuisances (P,) and effects."""
    energies = np.sum([one.energies for one in linear.records], axis=0)
    scale = common_scale(linear.numbers, offset, settings, parameters, linear.records[0].equations.trajectory.known, energies)
    if scale is None:
        return Held(offset, settings, None)
    own = scale.changes[: len(offset)]
    times = float(own[scale.constant] / (own[scale.constant] + linear.offset[scale.constant] - offset[scale.constant]))
    steps = [settings[k].parameters[one.name] * (times ** -power_of_force(one.unit) - 1.0) for k, one in parameters]
    return Held(offset + own * (1.0 / times - 1.0), moved(settings, parameters, steps), scale)
