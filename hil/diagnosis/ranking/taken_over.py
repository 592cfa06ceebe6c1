"""Numbers of the machine file whose place an effect takes: beside an IMU's other low pass the file's own does nothing.

Where sensitivities of the machine without effects stand for those beside a set, such a number would imitate all that the effect does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.diagnosis.tuning.retune import Tuning
from virtual_bus.effects.table import changed_values
from virtual_bus.settings import EffectSetting, PlantSettings

OTHERWISE = 1.01
"""Factor on all numbers; those that come out the same beside the effects do nothing there."""


def acting(tuning: Tuning, chosen: Sequence[EffectSetting], settings: PlantSettings) -> np.ndarray:
    """(P,) whether each tuned number still does something beside these effects."""
    names = [(parameter.owner, parameter.quantity) for parameter in tuning.parameters]
    found = []
    for factor in (1.0, OTHERWISE):
        values = dict(zip(names, (factor * tuning.values).tolist(), strict=True))
        values |= {(imu.name, "low_pass_shape"): 0.0 for imu in settings.imus}
        changed_values(values, chosen, settings)
        found.append(np.array([values[names[index]] for index in tuning.indices]))
    return np.asarray(found[0] != found[1])


def without_those_taken_over(tuning: Tuning, chosen: Sequence[EffectSetting], settings: PlantSettings) -> Tuning:
    """The tuning with what these numbers do beside the effects: nothing."""
    acts = acting(tuning, chosen, settings)
    return tuning if acts.all() else replace(tuning, jacobian=np.where(acts, tuning.jacobian, 0.0))
