"""Effects that sensors' readings show by themselves, before any motion is computed: they are taken into account, and sought no more."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.diagnosis.observed.rows import Observed
from virtual_bus.effects.effect import LATTICE, Effect
from virtual_bus.effects.places import imu_channel_names, places
from virtual_bus.effects.readings import Readings, Shown
from virtual_bus.effects.registry import effects, in_readings
from virtual_bus.settings import EffectSetting, PlantSettings


@dataclass(frozen=True, eq=False)
class ShownAt:
    """An effect that the readings of a channel show.

    Attributes
    ----------
    setting : EffectSetting
    shown : Shown
    """

    setting: EffectSetting
    shown: Shown


def shown_by_readings(recordings: Sequence[Observed]) -> tuple[list[Observed], tuple[ShownAt, ...]]:
    """Return recordings without the readings that were held, on the lattices that they are on; and the effects that did so."""
    found = []
    every = list(recordings)
    in_order = sorted(effects().values(), key=lambda effect: effect.kind is not LATTICE)  # held readings are told by their lattice
    for effect in in_order:
        for at in _places(effect, every[0].machine.plant):
            values = [_readings(one, at) for one in every]
            if any(each is None for each in values):
                continue
            plant = every[0].machine.plant
            is_position = any(encoder.channel == at for encoder in plant.encoders)
            known = Readings(tuple(each for each in values if each is not None), _step(plant, at), is_position)
            shown = in_readings(effect.name, known)
            if shown is None:
                continue
            found.append(ShownAt(EffectSetting(effect.name, at, {name: value for name, (value, _, _) in shown.values.items()}), shown))
            every = [_without(one, at, held, shown.step) for one, held in zip(every, shown.held, strict=True)]
    return every, tuple(found)


def _places(effect: Effect, settings: PlantSettings) -> list[str]:
    """Return the channels at which an effect that readings may show is not known already."""
    known = {one.at for one in settings.effects if one.name == effect.name}
    return [at for at in places(effect.kind, settings) if at not in known]


def _readings(one: Observed, channel: str) -> np.ndarray | None:
    """Return a channel's readings; None where it was not recorded, or stands for what was commanded."""
    axes = [sensor.axis for sensor in one.machine.plant.currents if sensor.channel == channel]
    if axes:
        axis = one.machine.axes.index(axes[0])
        values: np.ndarray = one.currents[:, axis]
        return None if one.are_measured[axis] or not np.isfinite(values).any() else values
    return one.readings[:, one.channels.index(channel)] if channel in one.channels else None


def _step(settings: PlantSettings, channel: str) -> float:
    """Return the step of the lattice that the machine file gives a channel; 0 where it gives none."""
    steps = {sensor.channel: sensor.resolution for sensor in (*settings.joint_sensors, *settings.currents)}
    felt = [resolution for imu in settings.imus for resolution in 3 * [imu.accelerometer_resolution_m_s2] + 3 * [imu.gyro_resolution_rad_s]]
    steps |= dict(zip(imu_channel_names(settings), felt, strict=True))
    return steps.get(channel, 0.0)


def _without(one: Observed, channel: str, held: np.ndarray, step: float) -> Observed:
    """Return a recording without a channel's held readings, whose encoder has this lattice."""
    plant = one.machine.plant
    encoders = tuple(replace(each, resolution=max(each.resolution, step)) if each.channel == channel else each for each in plant.encoders)
    machine = replace(one.machine, plant=replace(plant, encoders=encoders))
    readings, currents = one.readings.copy(), one.currents.copy()
    if channel in one.channels:
        readings[held, one.channels.index(channel)] = np.nan
    for sensor in plant.currents:
        if sensor.channel == channel:
            currents[held, one.machine.axes.index(sensor.axis)] = np.nan
    return replace(one, machine=machine, readings=readings, currents=currents)
