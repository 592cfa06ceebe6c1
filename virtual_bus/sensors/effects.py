"""Effects of sensors: errors of encoders, turned and scaled IMUs, lost signs, late clocks and lost samples of single channels.

Channels in one order: motor-side encoders by axis, link encoders by axis, currents by axis, six per IMU, then speeds by axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from virtual_bus.compilation.jit import compiled
from virtual_bus.effects.motion import EncoderErrorOf, LagOf, LostBy, SignedBy
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.effects.registry import module_of
from virtual_bus.effects.table import ROW, effect_row, values_of, with_hook
from virtual_bus.sensors.encoder import quantised
from virtual_bus.settings import EffectSetting, PlantSettings

HISTORY = 64  # samples that a late channel remembers
SENSOR_HOOKS = ("error", "resolution", "calibration", "signed", "lag_s", "is_lost")  # hooks of the effects' files that act on sensors
ANY, ERRORS, GAINS, CLOCKS, SIGNS, DROPOUTS = range(6)  # kinds of effects, as positions in `switches`


class SensorEffects(NamedTuple):
    """What effects change of a machine's sensors. Rows that begin with -1 are no effect."""

    encoder_channel: np.ndarray  # (errors,) channel of every encoder error
    encoder_rows: np.ndarray  # (errors, ROW)
    counts_from_start: np.ndarray  # (2 axes,) 1: incremental, its error is zero at the start
    lattice: np.ndarray  # (2 axes,) step of a further rounding; 0 means none
    imu_gain: np.ndarray  # (2 imus, 3, 3) accelerometer, gyro of each
    imu_offset: np.ndarray  # (6 imus,)
    switches: np.ndarray  # (6,) 1: there are effects of that kind, ANY to DROPOUTS
    sign_rows: np.ndarray  # (channels, ROW)
    clock_rows: np.ndarray  # (channels, 2, ROW) of the axis or IMU that a channel belongs to, and its own: their ages add up
    dropout_rows: np.ndarray  # (channels, ROW)
    period_s: np.ndarray  # (1,)


class SensorMemory(NamedTuple):
    """What the sensors carry from sample to sample. Preallocated and overwritten."""

    samples: np.ndarray  # (1,) since the start, counted where there are effects
    home_error: np.ndarray  # (2 axes,) error of incremental encoders at the start
    values: np.ndarray  # (channels,) of this instant, on their way to a reading
    raw: np.ndarray  # (channels,) before clock, sign, noise and lattice
    latest: np.ndarray  # (channels,) as read at this instant
    issued: np.ndarray  # (channels,) as read at the sample before
    history: np.ndarray  # (channels, HISTORY) raw values, a ring


def channel_names(settings: PlantSettings) -> list[str]:
    """Return the channels' names by number.

    Where the machine has no such sensor the place has the name that one would have.
    """
    axes = [drive.axis for drive in settings.drives]
    currents = {current.axis: current.channel for current in settings.currents}
    names = [f"position_{axis}" for axis in axes] + [f"link_position_{axis}" for axis in axes]
    names += [currents.get(axis, f"current_{axis}") for axis in axes] + imu_channel_names(settings)
    return names + [f"speed_{axis}" for axis in axes]


def new_memory(settings: PlantSettings) -> SensorMemory:
    """Return memory for `start` to begin with."""
    channels, encoders = len(channel_names(settings)), 2 * len(settings.drives)
    return SensorMemory(
        np.zeros(1, dtype=np.int64), np.zeros(encoders), np.zeros(channels), np.zeros(channels), np.zeros(channels), np.zeros(channels),
        np.zeros((channels, HISTORY)),
    )  # fmt: skip


def act_on_sensors(chosen: Sequence[EffectSetting]) -> bool:
    """Return whether any of these effects acts on sensors."""
    return any(hasattr(module_of(setting.name), hook) for setting in chosen for hook in SENSOR_HOOKS)


def sensor_effects(settings: PlantSettings, chosen: Sequence[EffectSetting]) -> SensorEffects:
    """Return the sensors' part of a machine's effects."""
    names = channel_names(settings)
    axes = [drive.axis for drive in settings.drives]
    absolute = {encoder.channel for encoder in settings.encoders if encoder.absolute}

    def channels(at: str) -> list[int]:
        if at in axes:
            return [axes.index(at), len(axes) + axes.index(at), len(names) - len(axes) + axes.index(at)]
        imus = [imu.name for imu in settings.imus]
        if at in imus:
            first = 3 * len(axes) + 6 * imus.index(at)
            return list(range(first, first + 6))
        return [names.index(at)]

    errors = with_hook(chosen, "error")
    lattice = np.zeros(2 * len(axes))
    for setting in with_hook(chosen, "resolution"):
        lattice[channels(setting.at)[0]] = module_of(setting.name).resolution(*values_of(setting))
    gain, offset = np.tile(np.eye(3), (2 * len(settings.imus), 1, 1)), np.zeros(6 * len(settings.imus))
    calibrations = with_hook(chosen, "calibration")
    for setting in calibrations:
        number = [imu.name for imu in settings.imus].index(setting.at)
        turned, shift = module_of(setting.name).calibration(*values_of(setting))
        both, six = slice(2 * number, 2 * number + 2), slice(6 * number, 6 * number + 6)
        offset[six] = np.einsum("kij,kj->ki", turned, offset[six].reshape(2, 3)).reshape(6) + shift
        gain[both] = turned @ gain[both]
    clocks = np.full((len(names), 2, ROW), -1.0)
    for setting in with_hook(chosen, "lag_s"):
        clocks[channels(setting.at), 1 if setting.at in names else 0] = effect_row(setting)
    rows = {}
    for hook in ("signed", "is_lost"):
        rows[hook] = np.full((len(names), ROW), -1.0)
        for setting in with_hook(chosen, hook):
            rows[hook][channels(setting.at)] = effect_row(setting)
    kinds = [len(errors), len(calibrations), *((each[..., 0] >= 0.0).any() for each in (clocks, rows["signed"], rows["is_lost"]))]
    switches = np.array([any(kinds) or lattice.any(), *kinds]) != 0
    return SensorEffects(
        np.array([channels(setting.at)[0] for setting in errors], dtype=np.int64),
        np.array([effect_row(setting) for setting in errors]).reshape(len(errors), ROW),
        np.array([name not in absolute for name in names[: 2 * len(axes)]], dtype=np.int64),
        lattice, gain, offset, switches.astype(np.int64),
        rows["signed"], clocks, rows["is_lost"], np.array([settings.sample_period_s]),
    )  # fmt: skip


@compiled
def encoder_error(channel: int, position: float, encoder_error_of: EncoderErrorOf, sensors: SensorEffects) -> float:
    """Return what an encoder sees beyond its position."""
    error = 0.0
    for row in range(len(sensors.encoder_channel)):
        if sensors.encoder_channel[row] == channel:
            error += encoder_error_of(int(sensors.encoder_rows[row, 0]), position, sensors.encoder_rows[row])
    return error


@compiled
def add_encoder_errors(encoder_error_of: EncoderErrorOf, sensors: SensorEffects, memory: SensorMemory) -> None:
    """Turn positions into what the encoders' scales show, in place."""
    for channel in range(len(sensors.lattice)):
        position = memory.values[channel]
        memory.values[channel] = position + encoder_error(channel, position, encoder_error_of, sensors) - memory.home_error[channel]


@compiled
def turn_imus(sensors: SensorEffects, memory: SensorMemory) -> None:
    """Apply gain and offset to the IMU channels, in place."""
    first = 3 * (len(sensors.lattice) // 2)
    for triple in range(len(sensors.imu_gain)):
        start = first + 3 * triple
        x, y, z = memory.values[start], memory.values[start + 1], memory.values[start + 2]
        for row in range(3):
            gain = sensors.imu_gain[triple, row]
            memory.values[start + row] = gain[0] * x + gain[1] * y + gain[2] * z + sensors.imu_offset[3 * triple + row]


@compiled
def raw_at(channel: int, sample: int, memory: SensorMemory) -> float:
    """Return a channel's value at an earlier sample; before the start it stood still."""
    sample = max(sample, 0)
    value: float = memory.raw[channel] if sample >= memory.samples[0] else memory.history[channel, sample % HISTORY]
    return value


@compiled
def value_before(channel: int, age: float, memory: SensorMemory) -> float:
    """Return a channel's value `age` samples ago, whole or not.

    It is a cubic through the two samples on either side, or through the latest four where the age is less than one (Lagrange's weights).
    """
    if age >= memory.samples[0]:  # it stood still
        return raw_at(channel, 0, memory)
    first = max(int(age) - 1, 0)
    latest, x = memory.samples[0] - first, age - first
    value = -(x - 1.0) * (x - 2.0) * (x - 3.0) / 6.0 * raw_at(channel, latest, memory)
    value += x * (x - 2.0) * (x - 3.0) / 2.0 * raw_at(channel, latest - 1, memory)
    value -= x * (x - 1.0) * (x - 3.0) / 2.0 * raw_at(channel, latest - 2, memory)
    return value + x * (x - 1.0) * (x - 2.0) / 6.0 * raw_at(channel, latest - 3, memory)


@compiled
def age_channels(lag_of: LagOf, sensors: SensorEffects, memory: SensorMemory) -> None:
    """Replace the values of late channels by earlier ones, in place."""
    now = memory.samples[0]
    for channel in range(len(memory.values)):
        memory.raw[channel] = memory.values[channel]
        age = 0.0
        for row in range(2):
            if sensors.clock_rows[channel, row, 0] >= 0.0:
                time_s = now * sensors.period_s[0]
                age += lag_of(int(sensors.clock_rows[channel, row, 0]), time_s, sensors.clock_rows[channel, row]) / sensors.period_s[0]
        age = min(age, HISTORY - 1.0)
        if age > 0.0:
            memory.values[channel] = value_before(channel, age, memory)


@compiled
def before_noise(
    encoder_error_of: EncoderErrorOf, signed_by: SignedBy, lag_of: LagOf, sensors: SensorEffects, memory: SensorMemory
) -> None:
    """Turn memory.values, the channels' true values at this instant, into what the sensors see."""
    if sensors.switches[ERRORS]:
        add_encoder_errors(encoder_error_of, sensors, memory)
    if sensors.switches[GAINS]:
        turn_imus(sensors, memory)
    if sensors.switches[CLOCKS]:
        age_channels(lag_of, sensors, memory)
    if sensors.switches[SIGNS]:
        for channel in range(len(memory.values)):
            if sensors.sign_rows[channel, 0] >= 0.0:
                row = sensors.sign_rows[channel]
                memory.values[channel] = signed_by(int(row[0]), memory.values[channel], row)
    for channel in range(len(sensors.lattice)):
        memory.values[channel] = quantised(memory.values[channel], sensors.lattice[channel])


@compiled
def repeat_lost(readings: np.ndarray, first: int, lost_by: LostBy, sensors: SensorEffects, memory: SensorMemory) -> None:
    """Repeat the last sample's readings where they are lost, in place.

    `readings` are those of the channels from `first` on.
    """
    for k in range(len(readings)):
        row = sensors.dropout_rows[first + k]
        if row[0] >= 0.0 and lost_by(int(row[0]), memory.samples[0], row):
            readings[k] = memory.issued[first + k]
        memory.latest[first + k] = readings[k]


@compiled
def remember(sensors: SensorEffects, memory: SensorMemory) -> None:
    """Keep what the next sample needs of this one, in place."""
    if sensors.switches[CLOCKS]:
        place = memory.samples[0] % HISTORY
        for channel in range(len(memory.raw)):
            memory.history[channel, place] = memory.raw[channel]
    if sensors.switches[DROPOUTS]:
        for channel in range(len(memory.latest)):
            memory.issued[channel] = memory.latest[channel]
    memory.samples[0] += 1
