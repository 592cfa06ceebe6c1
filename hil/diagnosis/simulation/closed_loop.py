"""Free runs of the closed loop beside one recording, from its reference on: nothing else that was recorded enters a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.signal

from hil.diagnosis.observed.rows import Observed
from hil.diagnosis.simulation.windows import MOST_STEPS, Errors, Starts, Windows, in_order
from hil.diagnosis.unknowns.unknowns import Machine
from hil.machine import Machine as Bench
from hil.recording import Recording
from hil.simulation import Inputs, Outputs, Simulator
from hil.simulation.control_laws import controllers_of, states_at_start
from hil.simulation.several import Own
from hil.simulation.smooth import simulated_matrix, smooth

HELD = ("excitation", "feedforward", "damping")
"""Channels of an axis that act besides its reference."""


class ClosedLoop:
    """Free runs of the machine under the controller that a recording was made with.

    Parameters
    ----------
    number : int
        Of the recording.
    observed : Observed
    """

    def __init__(self, number: int, observed: Observed) -> None:
        recording = observed.recording
        self.number, self.first_row = number, 0
        self.simulator = Simulator(smooth(controllers_of(observed.machine, recording)))
        machine = self.simulator.machine
        self.known = observed.machine.plant.effects
        self.recorded_time = recording.time - recording.time[0]
        rate = machine.sample_rate_Hz
        self._ticks = np.arange(int(np.floor(self.recorded_time[-1] * rate + 1e-6)) + 1) / rate
        sensors = [sensor.channel for sensor in machine.plant.joint_sensors]
        efforts = [f"{'current' if units.effort == 'A' else 'effort'}_{units.axis}" for units in machine.units]
        commands = [f"command_{axis}" for axis in machine.axes]
        given = [effort if _has(recording, effort) else command for effort, command in zip(efforts, commands, strict=True)]
        self.channels = tuple(name for name in (*sensors, *given) if _has(recording, name))
        self.axis_of = {c: given.index(name) for c, name in enumerate(self.channels) if name in given}
        self.recorded = np.column_stack([recording[name] for name in self.channels])
        self.rows, self.period_s = recording.rows, float(np.median(np.diff(self.recorded_time)))
        self.noise = np.array([_scatter(observed.machine, recording, name) for name in self.channels])
        self.starts: tuple[Starts, ...] = ()
        initial = recording.metadata.get("initial", {})
        self._states = initial.get("controller_states") or states_at_start(machine, recording, with_gain=True)
        self._speed = None if initial.get("speeds") is None else np.array(initial["speeds"], dtype=float)
        pose = recording.experiment.get("start_pose")
        self._pose = np.array(pose, dtype=float) if pose is not None else _first(machine.axes, recording)
        self.recorded_reference = np.column_stack([recording[f"reference_{axis}"] for axis in machine.axes])
        self._besides = {
            name: np.column_stack(
                [recording[f"{name}_{axis}"] if f"{name}_{axis}" in recording else 0.0 * self.recorded_time for axis in machine.axes]
            )
            for name in HELD
        }

    def _on_ticks(self, columns: np.ndarray, lateness_s: float) -> np.ndarray:
        at, each = self._ticks - lateness_s, ((np.isfinite(column), column) for column in columns.T)
        return np.column_stack([np.interp(at, self.recorded_time[there], column[there]) for there, column in each])

    def begin(
        self, machines: Sequence[Machine], starts: Sequence[Starts | None], windows: Sequence[Windows], threads: ThreadPoolExecutor
    ) -> Callable[[], list[Errors]]:
        """Begin to run machines over the whole recording; return what waits for their errors in its windows."""
        groups: dict[tuple[float, tuple[tuple[int, float], ...]], list[int]] = {}
        for k, machine in enumerate(machines):
            groups.setdefault((machine.lateness_s, machine.speed_limit), []).append(k)
        waiting = []
        joints = self.simulator.plant.joints
        for (lateness, limits), members in groups.items():
            besides = {name: self._on_ticks(values, lateness) for name, values in self._besides.items()}
            reference = _limited(self._on_ticks(self.recorded_reference, lateness), limits, self.simulator.machine.sample_rate_Hz)
            excitation = besides["excitation"] + besides["damping"]
            inputs = Inputs(reference, excitation, besides["feedforward"], None, self._pose, self._states, self._speed)
            trials = [(machines[k].values, (*self.known, *machines[k].effects)) for k in members]
            own = [Own(machines[k].gain, np.zeros(joints), np.zeros(joints), machines[k].early) for k in members]
            waiting.append((members, self.simulator.begin_all(inputs, trials, threads, own, MOST_STEPS)))
        return in_order(len(machines), waiting, lambda k, outputs: self._off(machines[k], outputs, windows))

    def _off(self, machine: Machine, outputs: object, windows: Sequence[Windows]) -> Errors:
        if not isinstance(outputs, Outputs):
            return None
        simulated = simulated_matrix(self.simulator.machine, outputs, self.channels)
        off = np.empty_like(self.recorded)
        for c in range(len(self.channels)):
            values = simulated[:, c]
            if c in self.axis_of:
                lag = machine.effort_lag_s.get(self.axis_of[c], 0.0)
                if lag > 0.0:
                    left = float(np.exp(-1.0 / (lag * self.simulator.machine.sample_rate_Hz)))
                    values = scipy.signal.lfilter([1.0 - left], [1.0, -left], values, zi=[left * values[0]])[0]
                values = values + machine.effort_zero.get(self.axis_of[c], 0.0)
            off[:, c] = np.interp(self.recorded_time, self._ticks, values) + machine.zeros.get((self.number, c), 0.0) - self.recorded[:, c]
        return tuple(off[each.at] for each in windows)


def _limited(reference: np.ndarray, limits: Sequence[tuple[int, float]], rate_Hz: float) -> np.ndarray:
    """Return references (N, axes) whose steps are no faster than their axis' limit: what is cut off is not made up for."""
    for axis, limit in limits:
        steps = np.diff(reference[:, axis])
        most = limit / rate_Hz
        if np.abs(steps).max(initial=0.0) > most:
            reference[1:, axis] = reference[0, axis] + np.cumsum(np.clip(steps, -most, most))
    return reference


def _has(recording: Recording, name: str) -> bool:
    return name in recording and bool(np.isfinite(recording[name]).any())


def _scatter(machine: Bench, recording: Recording, name: str) -> float:
    """Return the rms error of a channel by the machine file: of its steps, and of a current's noise."""
    steps = {sensor.channel: sensor.resolution / np.sqrt(12.0) for sensor in (*machine.plant.joint_sensors, *machine.plant.currents)}
    noise = {sensor.channel: sensor.noise_rms for sensor in machine.plant.currents}
    return max(float(np.hypot(steps.get(name, 0.0), noise.get(name, 0.0))), 1e-6 * float(np.nanstd(recording[name])))


def _first(axes: Sequence[str], recording: Recording) -> np.ndarray:
    each = (recording[f"position_{axis}"] for axis in axes)
    return np.array([values[np.isfinite(values)][0] for values in each])
