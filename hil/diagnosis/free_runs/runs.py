"""Free runs of the closed loop, from the reference alone, beside the mean of repeats.

Where the controller is the file's, a machine's equations say all that it does from the reference on: nothing that was recorded enters a
run, so that no sensor's noise bends an equation, and no law has to be linear about a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from controllers.errors import ControlError
from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.free_runs.scatter import Scatter
from hil.diagnosis.observed.groups import Group
from hil.diagnosis.observed.rows import Observed
from hil.diagnosis.seen.along import Along
from hil.diagnosis.seen.beside import Levels
from hil.diagnosis.seen.see import Seen
from hil.diagnosis.tuned.numbers import Numbers, numbers_of
from hil.diagnosis.tuned.retuning import Tuned, ZERO_m, ZERO_rad, biases_of, bounds_of, nominal_offset, tuned_at
from hil.errors import BenchError, RecordingError
from hil.recording.ticks import on_every_tick
from hil.simulation import Inputs, Simulator
from hil.simulation.simulate import inputs_of
from hil.simulation.simulator import Outputs
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.errors import EmulatorError
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.lanes import LANES
from virtual_bus.settings import EffectSetting

Trial = tuple[np.ndarray, tuple[EffectSetting, ...]]
"""Nuisances (P,) in standard deviations of their prior, and effects."""


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Repeats of one experiment, and the simulator beside them.

    Attributes
    ----------
    simulator, finer : Simulator
        In steps of the plant, and in halves of them.
    inputs : Inputs
    known : tuple of EffectSetting
        That act besides.
    parts : tuple of slice
        Rows of the simulation that are each repeat's: the same for all, or the periods of one recording.
    channels : tuple of str
        Readings, then measured efforts.
    mean : (N, C) array
        Of the samples that are there.
    is_missing : (N, C) bool array
        Where none is.
    deviations : (R, N, C) array
        What each repeat differs from it by.
    scatter : Scatter
    biases : (N, C, O) array
        What one standard deviation of each sensor's zero adds.
    step_error : (N, C) array
        What the plant's steps make of the readings.
    """

    simulator: Simulator
    finer: Simulator
    inputs: Inputs
    known: tuple[EffectSetting, ...]
    parts: tuple[slice, ...]
    channels: tuple[str, ...]
    mean: np.ndarray
    is_missing: np.ndarray
    deviations: np.ndarray
    scatter: Scatter
    biases: np.ndarray
    step_error: np.ndarray

    def about(self, numbers: Numbers, trial: Trial) -> FreeRun:
        """Return the same, its step error that of a machine: the integrator is of second order (Richardson 1911).

        It changes little from one machine to the next.
        """
        offset, settings = trial
        values = numbers.values(offset[: len(numbers.indices)])
        coarse, fine = (self._simulated(one.run(self.inputs, values, (*self.known, *settings))) for one in (self.simulator, self.finer))
        return replace(self, step_error=4.0 / 3.0 * (coarse - fine))

    def left(self, numbers: Numbers, trials: Sequence[Trial]) -> list[np.ndarray | None]:
        """Return the whitened misfits (N C,) of some machines; None where a run ends early."""
        count = len(numbers.indices)
        found: list[np.ndarray | None] = []
        for first in range(0, len(trials), LANES):  # a few at a time: their outputs would fill the memory
            together = trials[first : first + LANES]
            runs = [(numbers.values(offset[:count]), (*self.known, *settings)) for offset, settings in together]
            outputs = self.simulator.run_all(self.inputs, runs)
            found += [self._left_by(offset[count:], one) for (offset, _), one in zip(together, outputs, strict=True)]
        return found

    def _left_by(self, zeros: np.ndarray, outputs: object) -> np.ndarray | None:
        if not isinstance(outputs, Outputs):
            return None
        misfit = self.mean - (self._simulated(outputs) - self.step_error + self.biases @ zeros)
        left = self.scatter.whiten(_filled(misfit, self.is_missing))
        return left if np.isfinite(left).all() else None

    def _simulated(self, outputs: Outputs) -> np.ndarray:
        return _readings(self.simulator, outputs, self.parts, self.channels)


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """All experiments of a machine in free runs.

    Attributes
    ----------
    numbers : Numbers
    offset : (P,) array
        Nuisances in standard deviations of their prior: numbers, then sensors' zeros.
    runs : tuple of FreeRun
    readings : int
    levels : Levels
    along : Tuned
        The machine as it is seen along the recorded motion: what its places did there is where laws begin from.
    nuisances : tuple of (N C, P) arrays, or None
        What misfits lose per unit of each nuisance, beside a fit; they are computed at every step of a fit until there is one.
    """

    numbers: Numbers
    offset: np.ndarray
    runs: tuple[FreeRun, ...]
    readings: int
    levels: Levels
    along: Tuned
    nuisances: tuple[np.ndarray, ...] | None = None

    def about(self, alongs: Sequence[Along], trial: Trial, columns: Sequence[np.ndarray]) -> FreeRuns:
        """Return the same, seen at a machine; `columns` (N C, P, at least) are what misfits lose there per unit of each nuisance."""
        offset, settings = trial
        along = tuned_at(alongs, self.levels, offset, settings)
        nuisances = tuple(each[:, : len(offset)] for each in columns)
        return replace(
            self, offset=offset, along=along, nuisances=nuisances, runs=tuple(run.about(self.numbers, trial) for run in self.runs)
        )

    @property
    def plant(self) -> CompiledPlant:
        """The plant whose numbers they are."""
        return self.numbers.plant

    @property
    def values(self) -> np.ndarray:
        """The plant's parameters."""
        return self.numbers.values(self.offset[: len(self.numbers.indices)])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """How far each nuisance may move from here (P,), both ways."""
        return bounds_of(self.numbers, self.offset)

    @property
    def repeats(self) -> list[list[np.ndarray]]:
        """What each repeat differs from the mean by (N C,), whitened as that is, one list a run."""
        return [[run.scatter.whiten(each) for each in run.deviations] for run in self.runs]

    def left(self, trials: Sequence[Trial]) -> list[tuple[np.ndarray, ...] | None]:
        """Return the whitened misfits of some machines, one array (N C,) a run; None where a run ends early."""
        each = [run.left(self.numbers, trials) for run in self.runs]
        return [None if any(one is None for one in parts) else parts for parts in zip(*each, strict=True)]


def free_runs(seen: Seen, audit: Audit) -> FreeRuns:
    """Return free runs beside what was seen.

    Raises
    ------
    RecordingError
        An experiment has no repeats, a controller or its states at row 0 are not known, or the file's machine cannot run.
    """
    machine = audit.machine
    if single := [group.names[0] for group in seen.groups if len(group.repeats) < 2]:
        raise RecordingError(f"{single[0]}: free runs need repeats of its experiment; record some, or judge without free runs")
    if machine.controllers:
        known = {axis.axis for axis in audit.axes if axis.status == "as_filed"}
        if unknown := [axis for axis in machine.axes if axis not in known]:
            needs = "free runs need the controller that recorded, and its reference, command and position"
            raise RecordingError(f"{unknown[0]}: {needs}; correct the machine file, or judge without free runs")
        for repeat in (repeat for group in seen.groups for repeat in group.repeats):
            if "controller_states" not in repeat.recording.metadata.get("initial", {}):
                needs = "free runs need metadata initial.controller_states, which the bench writes"
                raise RecordingError(f"{repeat.name}: {needs}; judge without free runs")
    numbers, offset = numbers_of(seen.alongs[0].plant), nominal_offset(seen.alongs)
    try:
        runs = tuple(_free_run(seen, number, group).about(numbers, (offset, ())) for number, group in enumerate(seen.groups))
    except (BenchError, EmulatorError, ControlError) as error:
        raise RecordingError(f"no free runs of {machine.name}: {error}; judge without them") from None
    along = tuned_at(seen.alongs, seen.levels, offset)
    found = FreeRuns(numbers, offset, runs, sum(run.mean.size for run in runs), seen.levels, along)
    if found.left([(offset, ())]) == [None]:
        raise RecordingError(f"free runs of {machine.name} run away; judge without them")
    return found


def _free_run(seen: Seen, number: int, group: Group) -> FreeRun:
    first = group.repeats[0]
    whole = on_every_tick(first.recording)
    simulator, finer = Simulator(smooth(first.machine)), Simulator(smooth(first.machine, 2))
    efforts = [f"{'current' if units.effort == 'A' else 'effort'}_{units.axis}" for units in first.machine.units]
    measured = ~np.isnan(np.mean([each.currents for each in group.repeats], axis=0)).all(axis=0)
    channels = (*first.channels, *(name for name, is_there in zip(efforts, measured, strict=True) if is_there))
    readings = np.stack([np.hstack([each.readings, each.currents[:, measured]]) for each in group.repeats])
    along = seen.alongs[number]
    encoder_steps = {sensor.channel: sensor.resolution for sensor in along.settings.joint_sensors}
    are_there = np.isfinite(readings)
    mean = np.where(are_there, readings, 0.0).sum(axis=0) / np.maximum(are_there.sum(axis=0), 1)
    is_missing = ~are_there.any(axis=0)
    deviations = np.stack([_filled(each - mean, ~there) for each, there in zip(readings, are_there, strict=True)])
    biases = biases_of(seen.alongs)
    zeros = np.zeros((*mean.shape, len(biases)))
    for k, bias in enumerate(biases):
        own = bias.of(number)
        if own is not None:
            encoder = next(each for each in along.settings.encoders if each.channel == channels[own.channel])
            kind = along.settings.tree.joints[along.joints.index(encoder.joints[0])].kind
            zeros[:, own.channel, k] = ZERO_m if kind == "prismatic" else ZERO_rad
            if bias.recording is not None:  # each repeat has its own zero
                deviations[:, :, own.channel] -= deviations[:, :, own.channel].mean(axis=1, keepdims=True)
    parts = tuple(_rows(each) if group.are_periods else _rows(first) for each in group.repeats)
    inputs, known, none = inputs_of(first.machine, whole), tuple(along.known), np.zeros_like(mean)
    stepped = replace(first.machine, plant=replace(first.machine.plant, substeps=simulator.machine.plant.substeps))
    with_lattices, without = (_readings(one, one.run(inputs, effects=known), parts, channels) for one in (Simulator(stepped), simulator))
    steps = np.array([encoder_steps.get(name, 0.0) for name in channels])
    apart = np.mean(deviations**2, axis=(0, 1)) / np.maximum(steps**2, 1e-300)
    alike = float(np.max(np.exp(-2.0 * np.pi**2 * apart), where=steps > 0.0, initial=0.0))
    scatter = Scatter(deviations, alike * (with_lattices - without))
    return FreeRun(simulator, finer, inputs, known, parts, channels, mean, is_missing, deviations, scatter, zeros, none)


def _readings(simulator: Simulator, outputs: Outputs, parts: Sequence[slice], channels: Sequence[str]) -> np.ndarray:
    """Return the readings (N, C) of a run, the mean over what are repeats."""
    whole = simulated_matrix(simulator.machine, outputs, channels)
    readings: np.ndarray = np.mean([whole[part] for part in parts], axis=0)
    return readings


def _rows(one: Observed) -> slice:
    begin = round(one.begin_s / one.period_s)
    return slice(begin, begin + one.rows)


def _filled(values: np.ndarray, are_missing: np.ndarray) -> np.ndarray:
    """Return values (N, C) with those that are missing interpolated: what is missing says nothing."""
    rows, filled = np.arange(len(values)), values.copy()
    for column in np.flatnonzero(are_missing.any(axis=0)):
        missing = are_missing[:, column]
        filled[missing, column] = 0.0 if missing.all() else np.interp(rows[missing], rows[~missing], values[~missing, column])
    return filled
