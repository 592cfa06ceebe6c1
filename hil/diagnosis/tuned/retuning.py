"""Re-tuning: the machine file's numbers within their tolerances, by Gauss-Newton on the whitened recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.candidates.columns import Column, Filtered, column
from hil.diagnosis.seen.along import Along, Motion, Signals
from hil.diagnosis.seen.beside import Beside, Levels, beside
from hil.diagnosis.seen.filtering import Whitening
from hil.diagnosis.tuned.numbers import Numbers, numbers_of
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.settings import EffectSetting

STEP = 1e-3
"""Of a column's difference, in standard deviations of a number: half the digits of a double are left."""
DETERMINED = 1.0
"""Square of a column, in units of noise, below which the recordings say less of a nuisance than its prior."""
ZERO_rad, ZERO_m = 0.01, 1e-3
"""Standard deviation of an encoder's zero: of a disc set on a shaft by hand, or of a stop that homing runs onto."""


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
    offsets : (N m, O) array
        Whitened columns of the sensors' offsets.
    of : Numbers
    at : (P - O,) array
        Where the numbers are, in standard deviations of their prior.
    """

    beside: Beside
    whitening: Whitening
    motion: Motion
    signals: Signals
    innovations: np.ndarray
    offsets: np.ndarray
    of: Numbers
    at: np.ndarray

    @cached_property
    def numbers(self) -> np.ndarray:
        """Whitened columns (N m, P) of the nuisances: numbers, then offsets of sensors."""
        along, columns = self.beside.along, []
        for k in range(len(self.at)):
            moved = self.at.copy()
            moved[k] += STEP
            with_it = along.signals(self.motion, along.model(self.of.values(moved)), beside=self.signals)
            columns.append(column(self.signals, with_it, STEP))
        return np.hstack([self.whiten(columns), self.offsets])

    @cached_property
    def energies(self) -> np.ndarray:
        """Squares (P,) of the columns of nuisances."""
        squares: np.ndarray = np.einsum("ij,ij->j", self.numbers, self.numbers)
        return squares

    def whiten(self, columns: Sequence[Column]) -> np.ndarray:
        """Return whitened columns (N m, C)."""
        rows, channels = self.beside.left.shape
        return Filtered(self.whitening, columns, self.beside.missing.shape[1], channels).whole(rows)


@dataclass(frozen=True, eq=False)
class Tuned:
    """A machine's numbers after re-tuning.

    Attributes
    ----------
    numbers : Numbers
    offset : (P,) array
        Nuisances in standard deviations of their prior: numbers, then offsets of sensors.
    looked : tuple of Looked
    readings : int
    levels : Levels
    """

    numbers: Numbers
    offset: np.ndarray
    looked: tuple[Looked, ...]
    readings: int
    levels: Levels

    @property
    def plant(self) -> CompiledPlant:
        """The plant whose numbers they are."""
        return self.numbers.plant

    @cached_property
    def values(self) -> np.ndarray:
        """The plant's parameters."""
        return self.numbers.values(self.offset[: len(self.numbers.indices)])

    def without_offsets(self) -> list[np.ndarray]:
        """Return what is left of every recording's innovations (N m,) with the offsets of sensors that leave least."""
        return least_left([one.innovations for one in self.looked], [one.offsets for one in self.looked])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """How far each nuisance may move from here (P,), both ways."""
        return bounds_of(self.numbers, self.offset)


def least_left(left: Sequence[np.ndarray], columns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return what is left (N m,) of every recording with the offsets whose columns (N m, O) leave least, beside their prior."""
    squares = np.sum([each.T @ each for each in columns], axis=0)
    slopes = np.sum([each.T @ rest for each, rest in zip(columns, left, strict=True)], axis=0)
    offsets = np.linalg.solve(squares + np.eye(len(squares)), slopes)
    return [rest - each @ offsets for rest, each in zip(left, columns, strict=True)]


def bounds_of(numbers: Numbers, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far nuisances at this offset may move."""
    free = np.full(len(offset) - len(numbers.indices), np.inf)
    return np.append(numbers.low, -free) - offset, np.append(numbers.high, free) - offset


def tuned_at(alongs: Sequence[Along], levels: Levels, offset: np.ndarray, effects: Sequence[EffectSetting] = ()) -> Tuned:
    """Return the machine with these nuisances, its motion read off the sensors with these effects."""
    numbers, biases = numbers_of(alongs[0].plant), biases_of(alongs)
    if levels.are_assumed:
        numbers = numbers.holding("constant")  # weaker drives and lighter machines would make all that is left smaller
    looked = tuple(look(along, numbers, [bias.of(k) for bias in biases], offset, levels, effects) for k, along in enumerate(alongs))
    return Tuned(numbers, offset, looked, sum(one.whitening.readings for one in looked), levels)


def nominal_offset(alongs: Sequence[Along]) -> np.ndarray:
    """Return the nuisances (P,) of the machine file: all zero."""
    return np.zeros(len(numbers_of(alongs[0].plant).indices) + len(biases_of(alongs)))


def look(
    along: Along, numbers: Numbers, biases: Sequence[Bias | None], offset: np.ndarray, levels: Levels, effects: Sequence[EffectSetting] = ()
) -> Looked:
    """Put a recording beside the equations with these nuisances.

    Where friction acts, the effort on a joint is unknown up to its level while nothing says which way the joint moves.
    """
    count = len(numbers.indices)
    one = beside(along, numbers.values(offset[:count]))
    levels = _of_this_inertia(levels, along, one)
    constants = [_constant(along, bias) for bias in biases]
    left = one.left.copy()
    for value, constant in zip(offset[count:], constants, strict=True):
        for channel, column_of in constant.readings.items():
            left[:, channel] -= value * column_of
    one = one.with_left(left)
    filtered = one.whitening(levels)
    one = one.about(one.motion(filtered, by_encoders=False))
    motion = one.motion(filtered)
    model = along.model(numbers.values(offset[:count]), effects)
    if effects or along.known:
        without = along.signals(motion, one.model)
        with_it = column(without, along.signals(motion, model, effects, beside=without))
        unsure = along.unknown_friction(motion, model)
        motion = one.less(with_it.efforts, with_it.readings).motion(one.whitening(levels, unsure))
        filtered = one.whitening(levels, along.unknown_friction(motion, model))
    given = along.given(motion, model, effects)
    motion = _by_encoders(along, motion) if levels.are_assumed else _as_the_equations_say(along, one, motion, given)
    signals = along.signals(motion, one.model)
    one = one.given_along(signals)
    rows, channels = one.left.shape
    offsets = Filtered(filtered, constants, one.missing.shape[1], channels).whole(rows)
    return Looked(one, filtered, motion, signals, one.whitened(filtered).reshape(-1), offsets, numbers, offset[:count])


def _of_this_inertia(levels: Levels, along: Along, one: Beside) -> Levels:
    """Return levels whose disturbances accelerate a lighter or heavier machine as they do that of the file.

    Otherwise every machine would be found lighter, and its drives weaker, than it is: the same motion would need smaller disturbances.
    """
    here, file = (along.plant.inertias(model, one.base.position[0]) for model in (one.model, along.model()))
    jolts = None if levels.jolts is None else levels.jolts * here / file
    tones = None if levels.tones is None else levels.tones.times(here / file)
    return replace(levels, disturbance=levels.disturbance * here / file, jolts=jolts, tones=tones)


def _as_the_equations_say(along: Along, one: Beside, motion: Motion, given: np.ndarray) -> Motion:
    """Return the motion with the accelerations that efforts `given` (N, n) from row to row bring about in these positions and speeds.

    Accelerations read off sensors hold the very disturbances that columns are compared with.
    """
    inertia, _ = along.plant.inertia_and_bias(one.model, motion.position, motion.speed)
    needed = along.needed(motion, one.model)
    at_rows = 0.5 * (given + np.vstack([given[:1], given[:-1]]))
    further = np.linalg.solve(inertia, (at_rows - needed)[..., None])[..., 0]
    return replace(motion, acceleration=motion.acceleration + further)


def _by_encoders(along: Along, motion: Motion) -> Motion:
    """Return the motion with the slow accelerations that encoders show.

    Where noise is assumed, equations may be far off, and what they say of accelerations with them. What is faster is noise for the most
    part; it would make every inertia look smaller than it is.
    """
    acceleration = motion.acceleration.copy()
    for joint, one in along.smooth.items():
        acceleration[:, joint] = one.slow[:, 2]
    return replace(motion, acceleration=acceleration)


@dataclass(frozen=True)
class Bias:
    """An offset of a sensor: of the channel of this number, in one recording or (None) in all of them."""

    channel: int
    recording: int | None

    def of(self, recording: int) -> Bias | None:
        """Return this, where it acts in a recording."""
        return self if self.recording in (None, recording) else None


def biases_of(alongs: Sequence[Along]) -> list[Bias]:
    """Return the errors that sound sensors have: encoders' zeros, those of incremental ones anew in each recording."""
    settings, channels = alongs[0].settings, alongs[0].observed.channels
    encoders = {encoder.channel: encoder for encoder in settings.encoders}
    found = []
    for c, channel in enumerate(channels):
        if channel in encoders and not encoders[channel].absolute:
            found += [Bias(c, k) for k in range(len(alongs))]
        elif channel in encoders:
            found.append(Bias(c, None))
    return found


def _constant(along: Along, bias: Bias | None) -> Column:
    """Return an offset of a channel, in standard deviations of its prior."""
    if bias is None:
        return Column({}, {})
    channel = along.observed.channels[bias.channel]
    encoders = {encoder.channel: encoder for encoder in along.settings.encoders}
    joint = along.settings.tree.joints[along.joints.index(encoders[channel].joints[0])]
    unit = ZERO_m if joint.kind == "prismatic" else ZERO_rad
    return Column({}, {bias.channel: np.full(along.observed.rows, unit, dtype=np.float32)})
