"""Effects that were given as known, as an answer states them."""

from __future__ import annotations

from hil.diagnosis.result import EffectAt, KnownEffect
from virtual_bus.effects.places import drive_unit, is_prismatic
from virtual_bus.effects.registry import effects
from virtual_bus.settings import PlantSettings


def known_effects(settings: PlantSettings) -> tuple[KnownEffect, ...]:
    """Return the effects that a machine has before any is sought, with their units."""
    found = []
    for one in settings.effects:
        prismatic, unit = is_prismatic(one.at, settings), drive_unit(one.at, settings)
        parameters = effects()[one.name].parameters
        table = {each.name: (one.parameters[each.name], each.unit_at(prismatic, unit)) for each in parameters}
        found.append(KnownEffect(EffectAt(one.name, one.at), table))
    return tuple(found)
