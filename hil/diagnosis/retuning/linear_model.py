"""Re-tuning: the machine file's numbers within their tolerances, by Gauss-Newton on the whitened recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.diagnosis.candidates.columns import Column, Filtered, column
from hil.diagnosis.residuals.equation_errors import EquationErrors, Levels, equation_errors
from hil.diagnosis.residuals.trajectory import Motion, Signals, Trajectory
from hil.diagnosis.residuals.whitening import Whitening
from hil.diagnosis.retuning.numbers import Numbers, numbers_of
from virtual_bus.effects.effect import JOINT_CHANGE
from virtual_bus.effects.registry import effects as known_effects
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.settings import EffectSetting

STEP = 1e-3
"""Of a column's difference, in standard deviations of a number: half the digits of a double are left."""
DETERMINED = 1.0
"""Square of a column, in units of noise, below which the recordings say less of a nuisance than its prior."""
ZERO_rad, ZERO_m = 0.01, 1e-3
"""Standard deviation of an encoder's zero: of a disc set on a shaft by hand, or of a stop that homing runs onto."""


@dataclass(frozen=True, eq=False)
class LinearRecord:
    """One recording beside the tuned equations, whitened.

    Attributes
    ----------
    equations : EquationErrors
    whitening : Whitening
    motion : Motion
        Of all joints, by all sensors.
    signals : Signals
        Along that motion, nominal physics with the tuned numbers and `changes`.
    innovations : (N m,) array
    offsets : (N m, O) array
        Whitened columns of the sensors' offsets.
    of : Numbers
    at : (P - O,) array
        Where the numbers are, in standard deviations of their prior.
    changes : tuple of EffectSetting
        Effects that change numbers of joints: they are part of the equations, and of the signals.
    """

    equations: EquationErrors
    whitening: Whitening
    motion: Motion
    signals: Signals
    innovations: np.ndarray
    offsets: np.ndarray
    of: Numbers
    at: np.ndarray
    changes: tuple[EffectSetting, ...] = ()

    @cached_property
    def numbers(self) -> np.ndarray:
        """Whitened columns (N m, P) of the nuisances: numbers, then offsets of sensors."""
        trajectory, columns = self.equations.trajectory, []
        for k in range(len(self.at)):
            moved = self.at.copy()
            moved[k] += STEP
            with_it = trajectory.signals(self.motion, trajectory.model(self.of.values(moved), self.changes), nearby=self.signals)
            columns.append(column(self.signals, with_it, STEP))
        return np.hstack([self.whiten(columns), self.offsets])

    @cached_property
    def plain(self) -> Signals:
        """The signals without `changes`."""
        return self._with(()) if self.changes else self.signals

    @cached_property
    def change_alone(self) -> Mapping[tuple[str, str], tuple[EffectSetting, Signals]]:
        """By name and place, each of `changes` with the signals of it alone."""
        return {(each.name, each.at): (each, self._with((each,))) for each in self.changes}

    def _with(self, changes: tuple[EffectSetting, ...]) -> Signals:
        trajectory = self.equations.trajectory
        return trajectory.signals(self.motion, trajectory.model(self.of.values(self.at), changes), nearby=self.signals)

    @cached_property
    def energies(self) -> np.ndarray:
        """Squares (P,) of the columns of nuisances."""
        squares: np.ndarray = np.einsum("ij,ij->j", self.numbers, self.numbers)
        return squares

    def whiten(self, columns: Sequence[Column]) -> np.ndarray:
        """Return whitened columns (N m, C)."""
        rows, channels = self.equations.left.shape
        return Filtered(self.whitening, columns, self.equations.missing.shape[1], channels).whole(rows)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A machine's numbers after re-tuning.

    Attributes
    ----------
    numbers : Numbers
    offset : (P,) array
        Nuisances in standard deviations of their prior: numbers, then offsets of sensors.
    records : tuple of LinearRecord
    readings : int
    levels : Levels
    """

    numbers: Numbers
    offset: np.ndarray
    records: tuple[LinearRecord, ...]
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

    @property
    def changes(self) -> tuple[EffectSetting, ...]:
        """The effects that are part of the equations."""
        return self.records[0].changes

    def without_offsets(self) -> list[np.ndarray]:
        """Return what is left of every recording's innovations (N m,) with the offsets of sensors that leave least."""
        return least_left([one.innovations for one in self.records], [one.offsets for one in self.records])

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


def linear_at(trajectories: Sequence[Trajectory], levels: Levels, offset: np.ndarray, effects: Sequence[EffectSetting] = ()) -> LinearModel:
    """Return the machine with these nuisances, its motion read off the sensors with these effects."""
    numbers, biases = numbers_of(trajectories[0].plant), biases_of(trajectories)
    if levels.are_assumed:
        numbers = numbers.holding("constant")  # weaker drives and lighter machines would make all that is left smaller
    records = tuple(
        linearise_recording(trajectory, numbers, [bias.of(k) for bias in biases], offset, levels, effects)
        for k, trajectory in enumerate(trajectories)
    )
    return LinearModel(numbers, offset, records, sum(one.whitening.readings for one in records), levels)


def nominal_offset(trajectories: Sequence[Trajectory]) -> np.ndarray:
    """Return the nuisances (P,) of the machine file: all zero."""
    return np.zeros(len(numbers_of(trajectories[0].plant).indices) + len(biases_of(trajectories)))


def linearise_recording(
    trajectory: Trajectory,
    numbers: Numbers,
    biases: Sequence[Bias | None],
    offset: np.ndarray,
    levels: Levels,
    effects: Sequence[EffectSetting] = (),
) -> LinearRecord:
    """Put a recording beside the equations with these nuisances.

    Effects that change numbers of joints are part of the equations: the filter, too, knows how they answer to what disturbs the motion.
    Where friction acts, the effort on a joint is unknown up to its level while nothing says which way the joint moves.
    """
    count, changes = len(numbers.indices), tuple(each for each in effects if known_effects()[each.name].kind is JOINT_CHANGE)
    one = equation_errors(trajectory, numbers.values(offset[:count]), changes)
    # as strong as accelerates this machine as the file's: else every machine would be found lighter than it is, and its drives weaker
    levels = levels.accelerating(inertia_ratio(trajectory, one.model, one.base.position[0]))
    constants = [_constant(trajectory, bias) for bias in biases]
    left = one.left.copy()
    for value, constant in zip(offset[count:], constants, strict=True):
        for channel, column_of in constant.readings.items():
            left[:, channel] -= value * column_of
    one = one.with_left(left)
    filtered = one.whitening(levels)
    one = one.about(one.motion(filtered, by_encoders=False))
    motion = one.motion(filtered)
    model = trajectory.model(numbers.values(offset[:count]), effects)
    if effects or trajectory.known:
        without = trajectory.signals(motion, one.model)
        with_it = column(without, trajectory.signals(motion, model, effects, nearby=without))
        unsure = trajectory.unknown_friction(motion, model)
        motion = one.less(with_it.efforts, with_it.readings).motion(one.whitening(levels, unsure))
        filtered = one.whitening(levels, trajectory.unknown_friction(motion, model))
    given = trajectory.given(motion, model, effects)
    motion = _by_encoders(trajectory, motion) if levels.are_assumed else _as_the_equations_say(trajectory, one, motion, given)
    signals = trajectory.signals(motion, one.model)
    one = one.given_along(signals)
    rows, channels = one.left.shape
    offsets = Filtered(filtered, constants, one.missing.shape[1], channels).whole(rows)
    return LinearRecord(one, filtered, motion, signals, one.whitened(filtered).reshape(-1), offsets, numbers, offset[:count], changes)


def inertia_ratio(trajectory: Trajectory, model: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Return by how much the joints' inertias (n,) are those of the file in a position (n,)."""
    here, file = (trajectory.plant.inertias(each, position) for each in (model, trajectory.model()))
    return np.asarray(here / file)


def _as_the_equations_say(trajectory: Trajectory, one: EquationErrors, motion: Motion, given: np.ndarray) -> Motion:
    """Return the motion with the accelerations that efforts `given` (N, n) from row to row bring about in these positions and speeds.

    Accelerations read off sensors hold the very disturbances that columns are compared with.
    """
    inertia, _ = trajectory.plant.inertia_and_bias(one.model, motion.position, motion.speed)
    needed = trajectory.needed(motion, one.model)
    at_rows = 0.5 * (given + np.vstack([given[:1], given[:-1]]))
    further = np.linalg.solve(inertia, (at_rows - needed)[..., None])[..., 0]
    return replace(motion, acceleration=motion.acceleration + further)


def _by_encoders(trajectory: Trajectory, motion: Motion) -> Motion:
    """Return the motion with the slow accelerations that encoders show.

    Where noise is assumed, equations may be far off, and what they say of accelerations with them. What is faster is noise for the most
    part; it would make every inertia look smaller than it is.
    """
    acceleration = motion.acceleration.copy()
    for joint, one in trajectory.smooth.items():
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


def biases_of(trajectories: Sequence[Trajectory]) -> list[Bias]:
    """Return the errors that sound sensors have: encoders' zeros, those of incremental ones anew in each recording."""
    settings, channels = trajectories[0].settings, trajectories[0].observed.channels
    encoders = {encoder.channel: encoder for encoder in settings.encoders}
    found = []
    for c, channel in enumerate(channels):
        if channel in encoders and not encoders[channel].absolute:
            found += [Bias(c, k) for k in range(len(trajectories))]
        elif channel in encoders:
            found.append(Bias(c, None))
    return found


def _constant(trajectory: Trajectory, bias: Bias | None) -> Column:
    """Return an offset of a channel, in standard deviations of its prior."""
    if bias is None:
        return Column({}, {})
    channel = trajectory.observed.channels[bias.channel]
    encoders = {encoder.channel: encoder for encoder in trajectory.settings.encoders}
    joint = trajectory.settings.tree.joints[trajectory.joints.index(encoders[channel].joints[0])]
    unit = ZERO_m if joint.kind == "prismatic" else ZERO_rad
    return Column({}, {bias.channel: np.full(trajectory.observed.rows, unit, dtype=np.float32)})
