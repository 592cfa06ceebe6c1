"""The engineer's first fit: numbers, and the everyday effects at every driven joint."""

from __future__ import annotations

from hil.diagnosis.candidates.entries import different_places, effect_sought, setting_of
from hil.diagnosis.residuals.trajectory import Trajectory
from virtual_bus.effects.registry import effects
from virtual_bus.settings import EffectSetting


def everyday_effects(trajectory: Trajectory) -> tuple[EffectSetting, ...]:
    """Return all everyday effects at all axes whose efforts were recorded, without strength."""
    axes = {drive.axis for drive in trajectory.settings.drives} - set(trajectory.observed.imposed)
    return tuple(
        setting_of(effect_sought(effect.name), at, {})
        for effect in effects().values()
        if effect.everyday
        for at in different_places(effect, trajectory)
        if at in axes
    )
