"""Effects of a machine as the arrays its compiled plant reads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from virtual_bus.effects.effect import FRICTION, MAX_PARAMETERS
from virtual_bus.effects.registry import effect_number, effects
from virtual_bus.errors import EffectError
from virtual_bus.settings import EffectSetting

MAX_ROWS = 32  # friction effects of one machine: a compiled plant's table has a fixed size


def friction_table(settings: Sequence[EffectSetting], joint_of_axis: dict[str, int], joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Friction effects sorted by joint.

    Returns
    -------
    first : (joints + 1,) int64
        Rows of joint j are first[j] to first[j + 1].
    rows : (effects, 1 + MAX_PARAMETERS)
        Effect number, then the effect's parameters in its own order.

    Raises
    ------
    EffectError
        More effects than the table holds.
    """
    chosen = [setting for setting in settings if effects()[setting.name].kind is FRICTION]
    if len(chosen) > MAX_ROWS:
        raise EffectError(f"{len(chosen)} friction effects: a machine takes at most {MAX_ROWS}")
    chosen.sort(key=lambda setting: joint_of_axis[setting.at])
    rows = np.zeros((len(chosen), 1 + MAX_PARAMETERS))
    counts = np.zeros(joints, dtype=np.int64)
    for row, setting in zip(rows, chosen, strict=True):
        values = [setting.parameters[parameter.name] for parameter in effects()[setting.name].parameters]
        row[0] = effect_number(setting.name)
        row[1 : 1 + len(values)] = values
        counts[joint_of_axis[setting.at]] += 1
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int64), rows
