"""Free runs of the closed loop, from the reference alone, beside the mean of repeats.

Where the controller is the file's, a machine's equations say all that it does from the reference on: nothing that was recorded enters a
run, so that no sensor's noise bends an equation, and no law has to be linear about a motion.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from controllers.errors import ControlError
from hil.diagnosis.audit.audit import Audit
from hil.diagnosis.free_runs.scatter import Scatter
from hil.diagnosis.observed.groups import Group
from hil.diagnosis.observed.rows import Observed
from hil.diagnosis.residuals.equation_errors import Levels
from hil.diagnosis.residuals.residuals import Residuals
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.retuning.linear_model import DETERMINED, LinearModel, ZERO_m, ZERO_rad, biases_of, bounds_of, linear_at, nominal_offset
from hil.diagnosis.retuning.numbers import Numbers, numbers_of
from hil.errors import BenchError, RecordingError
from hil.machine import Machine
from hil.recording.ticks import on_every_tick
from hil.simulation import Inputs, Simulator
from hil.simulation.control_laws import controllers_of, states_at_start
from hil.simulation.simulate import inputs_of
from hil.simulation.simulator import Outputs
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.errors import EmulatorError
from virtual_bus.plant.compiled import CompiledPlant
from virtual_bus.plant.lanes import LANES
from virtual_bus.settings import EffectSetting

White = np.ndarray | None
"""A whitened misfit (N C,); None where a run ends early."""

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
    alike : (N, C) array
        What sensors' steps make, in the loop too, alike in all of them.
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
    alike: np.ndarray
    scatter: Scatter
    biases: np.ndarray
    step_error: np.ndarray

    def about(self, numbers: Numbers, trial: Trial) -> FreeRun:
        """Return the same, its step error that of a machine: the integrator is of second order (Richardson 1911).

        It changes little from one machine to the next.
        """
        offset, settings = trial
        machine = numbers.values(offset[: len(numbers.indices)]), (*self.known, *settings)
        runs = [one.run_or_error(self.inputs, *machine) for one in (self.simulator, self.finer)]
        whole = [self._simulated(one) for one in runs if isinstance(one, Outputs)]
        return replace(self, step_error=4.0 / 3.0 * (whole[0] - whole[1]) if len(whole) == 2 else np.zeros_like(self.mean))

    def begin(
        self, machines: Sequence[tuple[np.ndarray, tuple[EffectSetting, ...]]], zeros: Sequence[np.ndarray], threads: ThreadPoolExecutor
    ) -> Callable[[], list[White]]:
        """Begin to run machines of some values and effects, beside sensors' zeros; return what waits for them and returns misfits."""
        runs = [(values, (*self.known, *settings)) for values, settings in machines]
        outputs = self.simulator.begin_all(self.inputs, runs, threads)
        return lambda: self._left_by(zeros, outputs())

    def _left_by(self, zeros: Sequence[np.ndarray], outputs: Sequence[object]) -> list[White]:
        whole = {k: one for k, one in enumerate(outputs) if isinstance(one, Outputs)}
        if not whole:
            return [None] * len(outputs)
        shifts = np.array([zeros[k] for k in whole]) @ self.biases.reshape(-1, self.biases.shape[-1]).T
        misfits = self.mean + self.step_error - shifts.reshape(-1, *self.mean.shape)
        for misfit, one in zip(misfits, whole.values(), strict=True):
            misfit -= self._simulated(one)
            _fill(misfit, self.is_missing)
        left = dict(zip(whole, self.scatter.whiten(misfits), strict=True))
        return [left[k] if k in left and np.isfinite(left[k]).all() else None for k in range(len(outputs))]

    def _simulated(self, outputs: Outputs) -> np.ndarray:
        return readings_of(self.simulator, outputs, self.parts, self.channels)


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
    linear : LinearModel
        The machine as it is seen along the recorded motion: what its places did there is where laws begin from.
    are_shown : (P,) bool array
        Which nuisances the recordings say more of than their prior does; the others stay at the file's numbers.
    jobs : int or None
        Processors that simulations take at most; all of them with None.
    """

    numbers: Numbers
    offset: np.ndarray
    runs: tuple[FreeRun, ...]
    readings: int
    levels: Levels
    linear: LinearModel
    are_shown: np.ndarray
    jobs: int | None = None

    def about(self, trajectories: Sequence[Trajectory], trial: Trial, columns: Sequence[np.ndarray]) -> FreeRuns:
        """Return the same, seen at a machine; `columns` (N C, P, at least) are what misfits lose there per unit of each nuisance."""
        offset, settings = trial
        linear = linear_at(trajectories, self.levels, offset, settings)
        nuisances = [each[:, : len(offset)] for each in columns]
        are_shown = np.sum([np.einsum("ij,ij->j", each, each) for each in nuisances], axis=0) > DETERMINED
        runs = tuple(run.about(self.numbers, trial) for run in self.runs)
        return replace(self, offset=offset, linear=linear, are_shown=are_shown, runs=runs)

    @property
    def together(self) -> int:
        """How many machines are run together: as many as its processors take; as many again wait in memory."""
        return LANES * (self.jobs or os.cpu_count() or 1)

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
        count = len(self.numbers.indices)
        begun: list[list[Callable[[], list[White]]]] = []
        found: list[tuple[np.ndarray, ...] | None] = []

        def end(some: list[Callable[[], list[White]]]) -> None:
            each = [ended() for ended in some]
            found.extend(None if any(one is None for one in parts) else parts for parts in zip(*each, strict=True))

        with ThreadPoolExecutor(self.jobs or os.cpu_count()) as threads:
            for first in range(0, len(trials), self.together):
                some = trials[first : first + self.together]
                machines = [(self.numbers.values(offset[:count]), settings) for offset, settings in some]
                begun.append([run.begin(machines, [offset[count:] for offset, _ in some], threads) for run in self.runs])
                if len(begun) > 1:  # threads are busy with the next ones meanwhile
                    end(begun.pop(0))
            for rest in begun:
                end(rest)
        return found


def free_runs(residuals: Residuals, audit: Audit, jobs: int | None = None) -> FreeRuns:
    """Return free runs beside what was seen; with `jobs`, simulations take no more processors.

    Raises
    ------
    RecordingError
        An experiment has no repeats, a controller or its states at row 0 are not known, or the file's machine cannot run.
    """
    machine = audit.machine
    if single := [group.names[0] for group in residuals.groups if len(group.repeats) < 2]:
        raise RecordingError(f"{single[0]}: free runs need repeats of its experiment; record some, or judge without free runs")
    if lacks := lacking(residuals, audit):
        raise RecordingError(lacks)
    numbers, offset = numbers_of(residuals.trajectories[0].plant), nominal_offset(residuals.trajectories)
    try:
        runs = tuple(_free_run(residuals, number, group).about(numbers, (offset, ())) for number, group in enumerate(residuals.groups))
    except (BenchError, EmulatorError, ControlError) as error:
        raise RecordingError(f"no free runs of {machine.name}: {error}; judge without them") from None
    linear = linear_at(residuals.trajectories, residuals.levels, offset)
    found = FreeRuns(
        numbers, offset, runs, sum(run.mean.size for run in runs), residuals.levels, linear, np.ones(len(offset), dtype=bool), jobs
    )
    if found.left([(offset, ())]) == [None]:
        raise RecordingError(f"free runs of {machine.name} run away; judge without them")
    return found


def lacking(residuals: Residuals, audit: Audit) -> str:
    """Return what free runs of the closed loop lack beside recordings; '' where they are possible."""
    machine = audit.machine
    if not machine.controllers:
        return ""
    known = {axis.axis for axis in audit.axes if axis.status == "as_filed"}
    if unknown := [axis for axis in machine.axes if axis not in known]:
        needs = "free runs need the controller that recorded, and its reference, command and position"
        return f"{unknown[0]}: {needs}; correct the machine file, or judge without free runs"
    for group in residuals.groups:
        if len({str(repeat.recording.metadata.get("machine", {}).get("text")) for repeat in group.repeats}) > 1:
            return f"{group.names[0]}: its repeats were recorded by several machine files; free runs need one; judge without free runs"
    for repeat in (repeat for group in residuals.groups for repeat in group.repeats):
        has_states = "controller_states" in repeat.recording.metadata.get("initial", {})
        if not has_states and states_at_start(simulated_loop(repeat), repeat.recording) is None:
            why = "its commands, which are not what the controller computes, do not show the controller's states at row 0"
            return f"{repeat.name}: {why}; judge without free runs"
    return ""


def measured_by(group: Group) -> tuple[tuple[str, ...], tuple[slice, ...], np.ndarray]:
    """Return the readings and measured efforts of repeats: channels, each one's rows of the recording, and values (R, N, C)."""
    first = group.repeats[0]
    efforts = [f"{'current' if units.effort == 'A' else 'effort'}_{units.axis}" for units in first.machine.units]
    measured = ~np.isnan(np.mean([each.currents for each in group.repeats], axis=0)).all(axis=0)
    channels = (*first.channels, *(name for name, is_there in zip(efforts, measured, strict=True) if is_there))
    parts = tuple(_rows(each) if group.are_periods else _rows(first) for each in group.repeats)
    return channels, parts, np.stack([np.hstack([each.readings, each.currents[:, measured]]) for each in group.repeats])


def mean_of(readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean (N, C) over repeats (R, N, C) of the samples that are there, and where none is."""
    are_there = np.isfinite(readings)
    mean = np.where(are_there, readings, 0.0).sum(axis=0) / np.maximum(are_there.sum(axis=0), 1)
    return mean, ~are_there.any(axis=0)


def simulated_loop(first: Observed) -> Machine:
    """Return the machine under the controller that a recording was made with."""
    return controllers_of(first.machine, first.recording)


def _free_run(residuals: Residuals, number: int, group: Group) -> FreeRun:
    """Return the repeats of a group, their last few rows left out where spectra of all rows would be slow."""
    first = group.repeats[0]
    whole = on_every_tick(first.recording)
    machine = simulated_loop(first)
    simulator, finer = Simulator(smooth(machine)), Simulator(smooth(machine, 2))
    channels, parts, readings = measured_by(group)
    rows = scipy.fft.prev_fast_len(readings.shape[1], real=True)
    parts, readings = tuple(slice(part.start, part.start + rows) for part in parts), readings[:, :rows]
    trajectory = residuals.trajectories[number]
    encoder_steps = {sensor.channel: sensor.resolution for sensor in trajectory.settings.joint_sensors}
    mean, is_missing = mean_of(readings)
    deviations = readings - mean
    for each in deviations:
        _fill(each, ~np.isfinite(each))
    biases = biases_of(residuals.trajectories)
    zeros = np.zeros((*mean.shape, len(biases)))
    for k, bias in enumerate(biases):
        own = bias.of(number)
        if own is not None:
            encoder = next(each for each in trajectory.settings.encoders if each.channel == channels[own.channel])
            kind = trajectory.settings.tree.joints[trajectory.joints.index(encoder.joints[0])].kind
            zeros[:, own.channel, k] = ZERO_m if kind == "prismatic" else ZERO_rad
            if bias.recording is not None:  # each repeat has its own zero
                deviations[:, :, own.channel] -= deviations[:, :, own.channel].mean(axis=1, keepdims=True)
    inputs, known, none = inputs_of(machine, whole), tuple(trajectory.known), np.zeros_like(mean)
    stepped = replace(machine, plant=replace(machine.plant, substeps=simulator.machine.plant.substeps))
    with_lattices, without = (readings_of(one, one.run(inputs, effects=known), parts, channels) for one in (Simulator(stepped), simulator))
    steps = np.array([encoder_steps.get(name, 0.0) for name in channels])
    apart = np.mean(deviations**2, axis=(0, 1)) / np.maximum(steps**2, 1e-300)
    alike = float(np.max(np.exp(-2.0 * np.pi**2 * apart), where=steps > 0.0, initial=0.0))
    common = alike * (with_lattices - without)
    scatter = Scatter(deviations, common)
    return FreeRun(simulator, finer, inputs, known, parts, channels, mean, is_missing, deviations, common, scatter, zeros, none)


def readings_of(simulator: Simulator, outputs: Outputs, parts: Sequence[slice], channels: Sequence[str]) -> np.ndarray:
    """Return the readings (N, C) of a run, the mean over what are repeats."""
    whole = simulated_matrix(simulator.machine, outputs, channels)
    if max(part.stop for part in parts) > len(whole):
        raise RecordingError(f"{simulator.machine.name}: a recording has more rows than ticks; free runs need one row a tick")
    readings: np.ndarray = np.mean([whole[part] for part in parts], axis=0)
    return readings


def _rows(one: Observed) -> slice:
    begin = round((one.begin_s - float(one.recording.time[0])) / one.period_s)
    return slice(begin, begin + one.rows)


def _fill(values: np.ndarray, are_missing: np.ndarray) -> None:
    """Interpolate values (N, C) that are missing: what is missing says nothing."""
    rows = np.arange(len(values))
    for column in np.flatnonzero(are_missing.any(axis=0)):
        missing = are_missing[:, column]
        values[missing, column] = 0.0 if missing.all() else np.interp(rows[missing], rows[~missing], values[~missing, column])
