"""Which numbers of a plant, and of effects, are forces: what no motion shows is a scale that all of them have in common.

Weaker drives on a lighter machine move it as before (Gautier 1991, base parameters).
"""

from __future__ import annotations

from collections.abc import Collection

from virtual_bus.effects.effect import power_of_force
from virtual_bus.effects.registry import effects
from virtual_bus.plant.parameters import PlantParameter
from virtual_bus.settings import EffectSetting

CONSTANT, BRAKE = "constant", "brake_effort"


def force_power(parameter: PlantParameter) -> float:
    """Return to which power a plant's number has a force: 1 of masses, stiffnesses and drives' constants, 0 of lengths.

    A closed brake holds whatever comes: it moves nothing.
    """
    if parameter.quantity == BRAKE:
        return 0.0
    return 1.0 if parameter.quantity == CONSTANT else power_of_force(parameter.unit)


def holds_force(setting: EffectSetting, free: Collection[str] = ()) -> bool:
    """Return whether an effect acts by a force, or by what has one in its unit, that is not among its `free` parameters."""
    every = effects()[setting.name].parameters
    return any(one.name not in free and power_of_force(one.unit) != 0.0 and setting.parameters[one.name] != 0.0 for one in every)
