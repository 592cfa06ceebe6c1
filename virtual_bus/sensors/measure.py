"""All sensors of a machine at one instant, as one compiled function on arrays.

With zeros for noise it is the noise-free machine that a simulation compares against.
"""

from __future__ import annotations

import inspect
import sys
from collections import namedtuple
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import NamedTuple

import numpy as np

from virtual_bus.compilation.generated_modules import load_generated
from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.dispatch import compiled_effects, dispatch_sources
from virtual_bus.effects.motion import EncoderErrorOf, LagOf, LostBy, SignedBy
from virtual_bus.sensors import current, effects, encoder, imu, thermometer
from virtual_bus.sensors.current import current_arrays, current_reading
from virtual_bus.sensors.effects import (
    DROPOUTS,
    SensorEffects,
    SensorMemory,
    act_on_sensors,
    before_noise,
    encoder_error,
    repeat_lost,
    sensor_effects,
)
from virtual_bus.sensors.encoder import encoder_arrays, encoder_reading, quantised, summed_position, summed_speed
from virtual_bus.sensors.imu import imu_arrays, measured_channel
from virtual_bus.sensors.thermometer import thermometer_arrays, warmed
from virtual_bus.settings import EffectSetting, PlantSettings


class SensorModel(NamedTuple):
    """Properties of a machine's sensors.

    A resolution of NaN (an ambient of NaN, for thermometers) says that the axis has no such sensor.
    """

    position_joints: np.ndarray  # (axes, n) weights of the joints in the sum
    position_resolution: np.ndarray  # (axes,) rad or m
    link_joints: np.ndarray  # (axes, n)
    link_resolution: np.ndarray  # (axes,)
    speed_joints: np.ndarray  # (axes, n)
    speed_resolution: np.ndarray  # (axes,) rad/s or m/s
    effort_resolution: np.ndarray  # (axes,) drive's unit
    imu_bias: np.ndarray  # (6 imus,)
    imu_resolution: np.ndarray  # (6 imus,)
    ambient_degC: np.ndarray  # (axes,)
    rise_per_effort2: np.ndarray  # (axes,) K
    temperature_decay: np.ndarray  # (axes,) over one sample
    temperature_resolution: np.ndarray  # (axes,) K
    switches: np.ndarray  # (6,) which kinds of effects there are, see ANY to DROPOUTS of effects.py
    effects: SensorEffects


PLAIN = SensorModel._fields[: SensorModel._fields.index("switches")]
PlainSensors = namedtuple("PlainSensors", PLAIN)  # type: ignore[misc]
"""The same without effects."""


class Readings(NamedTuple):
    """Sensor readings of one instant in SI and the drives' units. Preallocated and overwritten.

    NaN where an axis has no such sensor.
    """

    position: np.ndarray  # (axes,)
    link_position: np.ndarray  # (axes,)
    speed: np.ndarray  # (axes,)
    effort: np.ndarray  # (axes,)
    imu: np.ndarray  # (6 imus,)
    temperature_degC: np.ndarray  # (axes,)


def sensor_model(settings: PlantSettings, effects: Sequence[EffectSetting] | None = None) -> SensorModel:
    """Return the arrays `measure` takes of a machine's sensors, with these effects or the settings' own."""
    position_joints, position_resolution = encoder_arrays(settings, "position")
    link_joints, link_resolution = encoder_arrays(settings, "link_position")
    speeds = encoder_arrays(settings, "speed")
    bias, _, imu_resolution = imu_arrays(settings)
    none = sensor_effects(settings, ())
    own = SensorModel(
        position_joints, position_resolution, link_joints, link_resolution, *speeds, current_arrays(settings)[0], bias, imu_resolution,
        *thermometer_arrays(settings), none.switches, none,
    )  # fmt: skip
    return with_effects(own, settings, settings.effects if effects is None else effects)


def with_effects(own: SensorModel, settings: PlantSettings, effects: Sequence[EffectSetting]) -> SensorModel:
    """Return sensors that have no effects with these; the same sensors where none of these acts on sensors."""
    if not act_on_sensors(effects):
        return own
    added = sensor_effects(settings, effects)
    return own._replace(switches=added.switches, effects=added)


def new_readings(settings: PlantSettings) -> Readings:
    """Return readings for `measure` to fill."""
    axes = len(settings.drives)
    return Readings(np.zeros(axes), np.zeros(axes), np.zeros(axes), np.zeros(axes), np.zeros(6 * len(settings.imus)), np.zeros(axes))


def noise_rms(settings: PlantSettings) -> dict[str, float]:
    """Return the standard deviation of every noisy channel, by channel name, in the order `measure` takes its noise.

    That is efforts by axis, then IMUs.
    """
    by_axis = {sensor.axis: sensor for sensor in settings.currents}
    noises = {f"current_{d.axis}": by_axis[d.axis].noise_rms if d.axis in by_axis else 0.0 for d in settings.drives}
    letters = [f"{sensor}_{axis}" for sensor in ("accelerometer", "gyro") for axis in "xyz"]
    names = [f"{unit.name}.{letter}" for unit in settings.imus for letter in letters]
    return noises | dict(zip(names, imu_arrays(settings)[1].tolist(), strict=True))


@compiled
def start(state: np.ndarray, encoder_error_of: EncoderErrorOf, model: SensorModel, memory: SensorMemory) -> None:
    """Begin at this plant state: incremental encoders have no error here."""
    memory.samples[0] = 0
    sensors = model.effects
    for i in range(len(model.position_resolution)):
        for channel, weights in ((i, model.position_joints[i]), (i + len(model.position_resolution), model.link_joints[i])):
            memory.home_error[channel] = 0.0
            if sensors.counts_from_start[channel]:
                memory.home_error[channel] = encoder_error(channel, summed_position(weights, state), encoder_error_of, sensors)


@compiled
def measure(
    state: np.ndarray, effort: np.ndarray, temperature_rise: np.ndarray, imu_reading: np.ndarray, noise: np.ndarray, sensors: SensorModel,
    readings: Readings,
) -> None:  # fmt: skip
    """Read every sensor at this instant, for sensors without effects.

    Parameters
    ----------
    state : array
        The plant's, joint positions first.
    effort : (axes,) array
        Currents that flow from this instant on, in the drives' units.
    temperature_rise : (axes,) array
        K above ambient.
    imu_reading : (6 imus,) array
        From the plant's `imu_reading`.
    noise : (axes + 6 imus,) array
        Of this sample, in the channels' units.
    sensors : SensorModel
    readings : Readings
        Overwritten.
    """
    axes = len(effort)
    for i in range(axes):
        readings.position[i] = encoder_reading(summed_position(sensors.position_joints[i], state), sensors.position_resolution[i])
        readings.link_position[i] = encoder_reading(summed_position(sensors.link_joints[i], state), sensors.link_resolution[i])
        readings.speed[i] = encoder_reading(summed_speed(sensors.speed_joints[i], state), sensors.speed_resolution[i])
        readings.effort[i] = current_reading(effort[i], noise[i], sensors.effort_resolution[i])
        temperature = sensors.ambient_degC[i] + temperature_rise[i]
        readings.temperature_degC[i] = quantised(temperature, sensors.temperature_resolution[i])
    for k in range(len(imu_reading)):
        readings.imu[k] = measured_channel(imu_reading[k], sensors.imu_bias[k], noise[axes + k], sensors.imu_resolution[k])


@compiled
def measure_affected(
    state: np.ndarray, effort: np.ndarray, temperature_rise: np.ndarray, imu_reading: np.ndarray, noise: np.ndarray,
    encoder_error_of: EncoderErrorOf, signed_by: SignedBy, lag_of: LagOf, lost_by: LostBy, sensors: SensorModel, memory: SensorMemory,
    readings: Readings,
) -> None:  # fmt: skip
    """Read every sensor at this instant, for sensors with effects.

    The functions are those of the effects' module, `memory` is a SensorMemory; the rest is as in `measure`.
    """
    axes = len(effort)
    first_speed = 3 * axes + len(imu_reading)
    added, values = sensors.effects, memory.values
    for i in range(axes):
        values[i] = summed_position(sensors.position_joints[i], state)
        values[axes + i] = summed_position(sensors.link_joints[i], state)
        values[2 * axes + i] = effort[i]
        values[first_speed + i] = summed_speed(sensors.speed_joints[i], state)
    for k in range(len(imu_reading)):
        values[3 * axes + k] = imu_reading[k]
    before_noise(encoder_error_of, signed_by, lag_of, added, memory)
    for i in range(axes):
        readings.position[i] = encoder_reading(values[i], sensors.position_resolution[i])
        readings.link_position[i] = encoder_reading(values[axes + i], sensors.link_resolution[i])
        readings.speed[i] = encoder_reading(values[first_speed + i], sensors.speed_resolution[i])
        readings.effort[i] = current_reading(values[2 * axes + i], noise[i], sensors.effort_resolution[i])
        temperature = sensors.ambient_degC[i] + temperature_rise[i]
        readings.temperature_degC[i] = quantised(temperature, sensors.temperature_resolution[i])
    for k in range(len(imu_reading)):
        readings.imu[k] = measured_channel(values[3 * axes + k], sensors.imu_bias[k], noise[axes + k], sensors.imu_resolution[k])
    if added.switches[DROPOUTS]:
        repeat_lost(readings.position, 0, lost_by, added, memory)
        repeat_lost(readings.link_position, axes, lost_by, added, memory)
        repeat_lost(readings.effort, 2 * axes, lost_by, added, memory)
        repeat_lost(readings.imu, 3 * axes, lost_by, added, memory)
        repeat_lost(readings.speed, first_speed, lost_by, added, memory)


@compiled
def warm_up(temperature_rise: np.ndarray, effort: np.ndarray, rise_per_effort2: np.ndarray, temperature_decay: np.ndarray) -> None:
    """Move the temperatures one sample on, in place."""
    for i in range(len(effort)):
        temperature_rise[i] = warmed(temperature_rise[i], effort[i], rise_per_effort2[i], temperature_decay[i])


@compiled
def counted(position: float, resolution: float) -> int:
    """Return the whole steps to a position that is on its lattice already; 0 where there is no lattice."""
    return round(position / resolution) if resolution > 0.0 else 0


@compiled
def count(readings: Readings, sensors: SensorModel, counts: np.ndarray) -> None:
    """Count both encoders of every axis into the second and third row; those on the motor side from the first row on."""
    for i in range(len(readings.position)):
        counts[1, i] = counted(readings.position[i], sensors.position_resolution[i]) - counts[0, i]
        counts[2, i] = counted(readings.link_position[i], sensors.link_resolution[i])


BLOCKS = {
    "of_joints": ("position_joints", "link_joints", "speed_joints"),
    "of_axes": (
        "position_resolution", "link_resolution", "speed_resolution", "effort_resolution", "ambient_degC", "rise_per_effort2",
        "temperature_decay", "temperature_resolution", "temperature_rise",
        "read_position", "read_link_position", "read_speed", "read_effort", "read_temperature_degC",
    ),
    "of_imus": ("imu_bias", "imu_resolution", "seen", "read_imu"),
}  # fmt: skip
"""What `sense` takes of a machine: few arrays, and what their rows are.

One by one the rows would take longer to hand over, in a tuple longer still.
"""

ENTRY_POINTS = '''"""Generated: the sensors as cached entry points; do not edit."""

from MODULE import encoder_error_of, lag_of, lost_by, signed_by
from virtual_bus.compilation.jit import compiled_and_cached, compiled_inside
from virtual_bus.sensors import effects as _effects
from virtual_bus.sensors import measure as _sensors


@compiled_and_cached
def start(state, sensors, memory):
    _sensors.start(state, encoder_error_of, sensors, memory)


@compiled_inside
def measure(state, effort, temperature_rise, imu_reading, noise, sensors, memory, readings):
    if sensors.switches[0]:
        _sensors.measure_affected(
            state, effort, temperature_rise, imu_reading, noise, encoder_error_of, signed_by, lag_of, lost_by, sensors, memory, readings
        )
    else:
        _sensors.measure(state, effort, temperature_rise, imu_reading, noise, sensors, readings)


@compiled_inside
def remember(sensors, memory):
    if sensors.switches[0]:
        _effects.remember(sensors.effects, memory)


@compiled_and_cached
def sense(state, effort, imu_reading, BLOCKS, counts, noise):
    sensors, readings = _sensors.PlainSensors(OWN), _sensors.Readings(READ)
    _sensors.measure(state, effort, of_axes[temperature_rise], imu_reading, noise, sensors, readings)
    for k in range(imu_reading.shape[0]):
        of_imus[seen][k] = imu_reading[k]
    _sensors.count(readings, sensors, counts)


@compiled_and_cached
def sense_affected(state, effort, imu_reading, BLOCKS, counts, EFFECTS, MEMORY, noise):
    added, memory = _effects.SensorEffects(EFFECTS), _effects.SensorMemory(MEMORY)
    sensors, readings = _sensors.SensorModel(OWN, added.switches, added), _sensors.Readings(READ)
    _sensors.measure_affected(
        state, effort, of_axes[temperature_rise], imu_reading, noise,
        encoder_error_of, signed_by, lag_of, lost_by, sensors, memory, readings,
    )
    for k in range(imu_reading.shape[0]):
        of_imus[seen][k] = memory.values[3 * effort.shape[0] + k]
    _sensors.count(readings, sensors, counts)


@compiled_and_cached
def pass_sample(effort, of_axes):
    _sensors.warm_up(of_axes[temperature_rise], effort, of_axes[rise_per_effort2], of_axes[temperature_decay])


@compiled_and_cached
def pass_affected(effort, of_axes, EFFECTS, MEMORY):
    _sensors.warm_up(of_axes[temperature_rise], effort, of_axes[rise_per_effort2], of_axes[temperature_decay])
    _effects.remember(_effects.SensorEffects(EFFECTS), _effects.SensorMemory(MEMORY))
'''


def sensor_sources() -> str:
    """Return the source of everything `measure` is compiled from.

    A module that fuses `measure` depends on it.
    """
    modules = (current, effects, encoder, imu, thermometer, sys.modules[__name__])
    return "\n".join(inspect.getsource(module) for module in modules) + dispatch_sources()


def compiled_sensors() -> ModuleType:
    """Return the module of ENTRY_POINTS, compiled once and cached."""
    text = ENTRY_POINTS.replace("MODULE", compiled_effects().__name__)
    place = {}
    for block, names in BLOCKS.items():
        for row, name in enumerate(names):
            place[name] = f"{block}[{row}]"
            text = text.replace(f"{block}[{name}]", place[name])
    lists: dict[str, Iterable[str]] = {
        "BLOCKS": BLOCKS,
        "OWN": [place[name] for name in PLAIN],
        "READ": [place[f"read_{name}"] for name in Readings._fields],
        "EFFECTS": SensorEffects._fields,
        "MEMORY": SensorMemory._fields,
    }
    for word, listed in lists.items():
        text = text.replace(word, ", ".join(listed))
    return load_generated("sensors", text, sensor_sources())
