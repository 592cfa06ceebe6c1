"""Re-tuning: the machine file's numbers within their tolerances, by Gauss-Newton on the whitened recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special

from hil.diagnosis.candidates.columns import Column, Filtered, column
from hil.diagnosis.seen.along import Along, Motion, Signals
from hil.diagnosis.seen.beside import Beside, Levels, beside
from hil.diagnosis.seen.filtering import Whitening
from hil.diagnosis.tuned.numbers import TOLERANCE, Numbers, numbers_of
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.settings import EffectSetting

STEP = 1e-3
"""Of a column's difference, in standard deviations of a number: half the digits of a double are left."""
BIAS = 0.1
"""Standard deviation of an IMU channel's bias beside the machine file's, in units of the noise of a reading: what is larger is the effect
of that name. At least a step of its lattice."""


@dataclass(frozen=True, eq=False)
class Looked:
    """One recording beside the tuned equations, whitened.

    Attributes
    ----------
    beside : Beside
    whitening : Whitening
    motion : Motion
        Of all joints, by all sensors.
    signals : Signals
        Along that motion, nominal physics with the tuned numbers.
    innovations : (N m,) array
    numbers : (N m, P) array
        Whitened columns of the nuisances: numbers, then sensors' biases.
    """

    beside: Beside
    whitening: Whitening
    motion: Motion
    signals: Signals
    innovations: np.ndarray
    numbers: np.ndarray

    def whiten(self, columns: Sequence[Column]) -> np.ndarray:
        """Return whitened columns (N m, C)."""
        rows, channels = self.beside.left.shape
        return Filtered(self.whitening, columns, self.beside.missing.shape[1], channels).block(0, rows)


@dataclass(frozen=True, eq=False)
class Tuned:
    """A machine's numbers after re-tuning.

    Attributes
    ----------
    numbers : Numbers
    offset : (P,) array
        Nuisances in standard deviations of their prior: numbers, then biases of IMU channels.
    looked : tuple of Looked
    readings : int
    """

    numbers: Numbers
    offset: np.ndarray
    looked: tuple[Looked, ...]
    readings: int

    @property
    def plant(self) -> CompiledPlant:
        """The plant whose numbers they are."""
        return self.numbers.plant

    @property
    def values(self) -> np.ndarray:
        """The plant's parameters."""
        return self.numbers.values(self.offset[: len(self.numbers.indices)])

    def energies(self, one: Looked) -> np.ndarray:
        """Return the squares (P,) of a recording's columns of nuisances."""
        squares: np.ndarray = np.einsum("ij,ij->j", one.numbers, one.numbers)
        return squares

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """How far each nuisance may move from here (P,), both ways."""
        return bounds_of(self.numbers, self.offset)


def bounds_of(numbers: Numbers, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far nuisances at this offset may move."""
    free = np.where(np.arange(len(offset)) < len(numbers.indices), TOLERANCE, np.inf)
    return -free - offset, free - offset


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of a machine's friction before the rest is sought.

    Attributes
    ----------
    effects : tuple of EffectSetting
        By which the motion is read off the sensors.
    dry : (n,) array
        Level of dry friction on every joint [Nm or N]: how far the effort on a joint is unknown while nothing says which way it moves.
    """

    effects: tuple[EffectSetting, ...]
    dry: np.ndarray


def tuned_at(alongs: Sequence[Along], levels: Levels, offset: np.ndarray, known: Known | None = None) -> Tuned:
    """Return the machine with these nuisances, seen with what is known of its friction."""
    numbers = numbers_of(alongs[0].plant)
    looked = tuple(look(along, numbers, offset, levels, known) for along in alongs)
    return Tuned(numbers, offset, looked, sum(one.whitening.readings for one in looked))


def nominal_offset(along: Along) -> np.ndarray:
    """Return the nuisances (P,) of the machine file: all zero."""
    return np.zeros(len(numbers_of(along.plant).indices) + len(bias_channels(along)))


def look(along: Along, numbers: Numbers, offset: np.ndarray, levels: Levels, known: Known | None = None) -> Looked:
    """Put a recording beside the equations with these nuisances, and find their columns."""
    count = len(numbers.indices)
    one = beside(along, numbers.values(offset[:count]))
    levels = _of_this_inertia(levels, along, one)
    biases = bias_columns(along, levels)
    left = one.left.copy()
    for value, bias in zip(offset[count:], biases, strict=True):
        ((channel, column_of),) = bias.readings.items()
        left[:, channel] -= value * column_of
    one = one.with_left(left)
    filtered = one.whitening(levels)
    motion = one.motion(filtered)
    if known is not None:
        model = along.plant.model(numbers.values(offset[:count]), known.effects)
        with_it = column(along.signals(motion, one.model), along.signals(motion, model, known.effects))
        unsure = known.dry**2 * (1.0 - _mean_direction(motion) ** 2)
        motion = one.less(with_it.efforts, with_it.readings).motion(one.whitening(levels, unsure))
        filtered = one.whitening(levels, known.dry**2 * (1.0 - _mean_direction(motion) ** 2))
    given = along.signals(motion, one.model).given
    if known is not None:
        given = along.signals(motion, model, known.effects).given
    motion = _as_the_equations_say(along, one, motion, given)
    signals = along.signals(motion, one.model)
    columns = []
    for k in range(count):
        moved = offset[:count].copy()
        moved[k] += STEP
        columns.append(column(signals, along.signals(motion, along.plant.model(numbers.values(moved), ())), STEP))
    columns += biases
    innovations = one.whitened(filtered)
    rows, channels = one.left.shape
    whitened = Filtered(filtered, columns, one.missing.shape[1], channels).block(0, rows)
    return Looked(one, filtered, motion, signals, innovations.reshape(-1), whitened)


def _of_this_inertia(levels: Levels, along: Along, one: Beside) -> Levels:
    """Return levels whose disturbances accelerate a lighter or heavier machine as they do that of the file.

    Otherwise every machine would be found lighter, and its drives weaker, than it is: the same motion would need smaller disturbances.
    """
    q = one.base.position[:1]
    inertias = [np.diag(along.plant.inertia_and_bias(model, q, 0.0 * q)[0][0]) for model in (one.model, along.plant.model(None, ()))]
    return replace(levels, disturbance=levels.disturbance * inertias[0] / inertias[1])


def _as_the_equations_say(along: Along, one: Beside, motion: Motion, given: np.ndarray) -> Motion:
    """Return the motion with the accelerations that efforts `given` (N, n) from row to row bring about in these positions and speeds.

    Accelerations read off sensors hold the very disturbances that columns are compared with.
    """
    inertia, _ = along.plant.inertia_and_bias(one.model, motion.position, motion.speed)
    needed = along.signals(motion, one.model).needed
    at_rows = 0.5 * (given + np.vstack([given[:1], given[:-1]]))
    further = np.linalg.solve(inertia, (at_rows - needed)[..., None])[..., 0]
    return replace(motion, acceleration=motion.acceleration + further)


def _mean_direction(motion: Motion) -> np.ndarray:
    """Return the mean sign (N, n) of speeds that are known up to their deviations."""
    mean: np.ndarray = scipy.special.erf(motion.speed / (np.sqrt(2.0) * np.maximum(motion.speed_deviation, 1e-12)))
    return mean


def bias_channels(along: Along) -> list[int]:
    """Return the numbers of the IMUs' channels: what they read at rest is never quite zero."""
    joints = {sensor.channel for sensor in along.settings.joint_sensors}
    return [c for c, channel in enumerate(along.observed.channels) if channel not in joints]


def bias_columns(along: Along, levels: Levels) -> list[Column]:
    """Return a constant on every IMU channel, in units of what a machine file's bias may be off by."""
    ones = np.ones(along.observed.rows, dtype=np.float32)
    steps = _imu_steps(along)
    return [
        Column({}, {c: ones * np.float32(max(steps[along.observed.channels[c]], BIAS * levels.sensors[c]))}) for c in bias_channels(along)
    ]


def _imu_steps(along: Along) -> dict[str, float]:
    """Return the resolution of every IMU channel."""
    steps = [
        resolution
        for imu in along.settings.imus
        for resolution in 3 * [imu.accelerometer_resolution_m_s2] + 3 * [imu.gyro_resolution_rad_s]
    ]
    return dict(zip(imu_channel_names(along.settings), steps, strict=True))
