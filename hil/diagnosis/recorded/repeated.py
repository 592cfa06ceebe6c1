"""Whether two recordings are repeats of one experiment, why they are not where they nearly are, and where repeats begin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.machine import Machine
from hil.recording import Recording
from hil.simulation import Inputs
from hil.simulation.simulate import position_channel

START_COUNTS = 20.0
"""Encoder counts that measured starts of repeats stand apart at most: for so little the bench makes no move (`ARRIVED_COUNTS`)."""

START_DEVIATIONS = 6.0
"""Standard deviations of what two readings differ by, from row to row, that measured starts stand apart at most."""

MEDIAN_OF_THIRD_DIFFERENCES = 0.6745 * 20.0**0.5
"""Of their size, of white noise of variance 1: their variance is 1 + 9 + 9 + 1."""

FEW_ROWS = 0.01
"""Of the rows: inputs that differ in fewer were meant to be the same."""

ROUNDED = 1e-9
"""Of an input's largest value, that two recordings of it may differ by: last digits, which another unit or another file leaves."""

INPUTS = ("reference", "command", "excitation", "feedforward")


@dataclass(frozen=True, eq=False)
class Member:
    """One recording of a group.

    `planned` are its inputs as the experiment asked for them, `inputs` with what an observer's damping added; `damped` is what the
    simulation makes of that beyond the group's mean, by channel.
    """

    label: str
    recording: Recording
    machine: Machine
    inputs: Inputs
    planned: Inputs
    damped: Mapping[str, np.ndarray] = field(default_factory=dict)

    def measured(self, channels: Sequence[str]) -> np.ndarray:
        """(N, C) as they would be under the group's mean damping."""
        rows = self.recording.matrix(channels)
        return rows - np.column_stack([self.damped[name] for name in channels]) if self.damped else rows

    @property
    def start_is_measured(self) -> bool:
        """Whether its start pose is a reading: neither metadata nor a reference say where it was to begin."""
        return self.planned.reference is None and self.recording.experiment.get("start_pose") is None


def are_repeats(one: Member, other: Member) -> bool:
    """Whether both ask for the same motion: how far from its start pose a machine stood is its own affair."""
    pairs = [(getattr(one.planned, name), getattr(other.planned, name)) for name in INPUTS]
    return _begin_alike(one, other) and all(_equal(a, b) for a, b in pairs)


def why_no_repeats(one: Member, other: Member) -> str:
    """How two recordings differ that would be repeats but for few rows of their inputs, or for how many rows they have, in words; "" where
    they differ otherwise.
    """
    if one.machine is not other.machine or not _begin_alike(one, other):
        return ""
    differing = dict(_differing(one, other))
    if not differing and all(member.recording.experiment.get("period_samples") for member in (one, other)):
        return ""  # each is split into its own periods
    if not differing:
        return f"it has {one.recording.rows} rows and not {other.recording.rows}"
    if abs(one.recording.rows - other.recording.rows) > 1:
        return ""
    count = np.unique(np.concatenate(list(differing.values()))).size
    if all(name.startswith("feedforward_") for name in differing):
        return f"its feedforward differs in {count} row{'' if count == 1 else 's'}, of inputs that are the same else"
    if count >= FEW_ROWS * one.recording.rows:
        return ""
    first = min(differing, key=lambda name: int(differing[name][0]))
    row = int(differing[first][0])
    where = f"{first} in row {row} ({one.recording.time[row]:.6g} s)"
    return f"its inputs differ in {count} row{'' if count == 1 else 's'}, the first {where}"


def from_mean_start(members: Sequence[Member]) -> Inputs:
    """The inputs of repeats, from the mean of where they stood and of the controller states they stood with; as they are if all alike."""
    runs = [member.inputs for member in members]
    first = runs[0]
    if not all(np.array_equal(run.start_pose, first.start_pose) for run in runs):
        first = replace(first, start_pose=np.mean([run.start_pose for run in runs], axis=0))
    deviations = [np.zeros_like(first.start_pose) if run.deviation is None else run.deviation for run in runs]
    if all(np.array_equal(one, deviations[0]) for one in deviations[1:]):
        return first
    states = [run.controller_states for run in runs if run.controller_states is not None]
    if len(states) == len(runs):
        mean = {axis: {name: np.mean([run[axis][name] for run in states], axis=0) for name in states[0][axis]} for axis in states[0]}
        first = replace(first, controller_states=mean)
    return replace(first, deviation=np.mean(deviations, axis=0))


def are_equal_inputs(one: np.ndarray, other: np.ndarray, largest: float = 0.0) -> bool:
    """Whether two inputs are the same, but for how their recorder's file rounded them; of parts of an input, `largest` is all of it."""
    if np.array_equal(one, other, equal_nan=True):
        return True
    if one.shape != other.shape or not np.array_equal(np.isfinite(one), np.isfinite(other)):
        return False
    there = np.isfinite(one)
    largest = max(float(np.abs(one[there]).max(initial=0.0)), largest)
    return bool(np.abs(one[there] - other[there]).max(initial=0.0) <= ROUNDED * largest)


def _equal(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    return one is other or (one is not None and other is not None and are_equal_inputs(one, other))


def _differing(one: Member, other: Member) -> Iterator[tuple[str, np.ndarray]]:
    """Input channels and their rows, of those that both have, that differ."""
    rows = min(one.recording.rows, other.recording.rows)
    for name in INPUTS:
        own, others = getattr(one.planned, name), getattr(other.planned, name)
        if own is None or others is None:
            continue
        for i, axis in enumerate(one.machine.axes):
            if (differ := np.flatnonzero(_differ(own[:rows, i], others[:rows, i]))).size:
                yield f"{name}_{axis}", differ


def _differ(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(one - other) > ROUNDED * np.abs(one).max(initial=0.0))


def _begin_alike(one: Member, other: Member) -> bool:
    """Where both were asked to begin at a pose, at the same one; where a reading says, so near as repeats stand."""
    if not _equal(one.planned.start_speed, other.planned.start_speed):
        return False
    if not (one.start_is_measured or other.start_is_measured):
        largest = 0.0 if one.planned.reference is None else float(np.abs(one.planned.reference).max(initial=0.0))
        return are_equal_inputs(one.planned.start_pose, other.planned.start_pose, largest)
    apart = np.abs(one.planned.start_pose - other.planned.start_pose)
    near = [_near(one.machine, one.recording, other.recording, axis) for axis in one.machine.axes]
    return bool(np.all(apart <= near))


def begin_near(machine: Machine, one: Recording, other: Recording) -> bool:
    """Whether the first readings of two recordings are so near as repeats stand, and of the same encoders."""
    for axis in machine.axes:
        name = position_channel(one, axis)
        if name != position_channel(other, axis):
            return False
        if name is None:
            continue
        first, its = (values[np.isfinite(values)][0] for values in (one[name], other[name]))
        if abs(first - its) > _near(machine, one, other, axis):
            return False
    return True


def _near(machine: Machine, one: Recording, other: Recording, axis: str) -> float:
    """How far apart [rad or m] an axis' measured starts may be by counts or by noise.

    What both readings differ by holds no motion that both make; its third differences hold no slow disturbance either.
    """
    name = position_channel(one, axis)
    if name is None or name != position_channel(other, axis):
        return 0.0
    count = next((encoder.resolution for encoder in machine.plant.encoders if encoder.channel == name), 0.0)
    rows = min(one.rows, other.rows)
    third = np.diff(one[name][:rows] - other[name][:rows], 3)
    third = third[np.isfinite(third)]
    deviation = float(np.median(np.abs(third))) / MEDIAN_OF_THIRD_DIFFERENCES if third.size else 0.0
    return max(START_COUNTS * count, START_DEVIATIONS * deviation)
