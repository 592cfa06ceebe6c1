"""Encoders and IMUs about rest: how their readings change with what they measure, and how old they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from virtual_bus.effects.registry import effects, module_of
from virtual_bus.plant.statics import DIFFERENCE
from virtual_bus.sensors.effects import HISTORY, SensorEffects, channel_names, sensor_effects
from virtual_bus.settings import EffectSetting, PlantSettings


def reading_gains(
    settings: PlantSettings, chosen: Sequence[EffectSetting], names: Sequence[str], joint_positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how the channels of these names (k,) read.

    Returns
    -------
    (k, k) array
        Readings per true values: errors of encoders at these joint positions (n,), gains and turns of IMUs, signs.
    (k,) array
        Their age [s] at the start.
    """
    sensors, all_names = sensor_effects(settings, chosen), channel_names(settings)
    gains, ages = np.eye(len(names)), np.zeros(len(names))
    place = {name: number for number, name in enumerate(names)}
    weights = {sensor.channel: sensor.joints for sensor in settings.joint_sensors}
    for number, channel in enumerate(sensors.encoder_channel):
        name = all_names[channel]
        if name in place:
            position = float(sum(joint_positions[settings.tree.joint_index(joint)] for joint in weights[name]))
            gains[place[name], place[name]] += _error_slope(sensors.encoder_rows[number], position)
    first = 3 * len(settings.drives)
    for triple, turned in enumerate(sensors.imu_gain):
        seen = [place[name] for name in all_names[first + 3 * triple : first + 3 * triple + 3] if name in place]
        if len(seen) == len(turned):
            gains[np.ix_(seen, seen)] = turned @ gains[np.ix_(seen, seen)]
    for number, name in enumerate(names):
        if name in all_names:
            channel = all_names.index(name)
            gains[number] *= _sign(sensors, channel)
            ages[number] = _age_s(sensors, channel, settings.sample_period_s)
    return gains, ages


def _error_slope(row: np.ndarray, position: float) -> float:
    error, values = _hook(row, "error")
    slope: float = (error(position + DIFFERENCE, *values) - error(position - DIFFERENCE, *values)) / (2.0 * DIFFERENCE)
    return slope


def _sign(sensors: SensorEffects, channel: int) -> float:
    row = sensors.sign_rows[channel]
    if row[0] < 0.0:
        return 1.0
    signed, values = _hook(row, "signed")
    sign: float = 0.5 * (signed(1.0, *values) - signed(-1.0, *values))
    return sign


def _age_s(sensors: SensorEffects, channel: int, period_s: float) -> float:
    age_s = 0.0
    for row in sensors.clock_rows[channel]:
        if row[0] >= 0.0:
            lag_s, values = _hook(row, "lag_s")
            age_s += lag_s(0.0, *values)
    return min(age_s, (HISTORY - 1.0) * period_s)


def _hook(row: np.ndarray, name: str) -> tuple[Callable[..., float], list[float]]:
    """Return an effect's function of that name and its parameters, of a row of a table."""
    effect = list(effects().values())[int(row[0])]
    return getattr(module_of(effect.name), name), row[1 : 1 + len(effect.parameters)].tolist()
