"""Free runs driven by the recorded efforts, with no controller to keep them near the recording: whole ones, or of a horizon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hil.diagnosis.residuals.assumed_noise import efforts_by_encoders
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.result import ErrorsOf
from hil.simulation import Inputs, Outputs, Simulator
from hil.simulation.inputs import Restarts
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.settings import EffectSetting

HORIZONS_s = (30.0, 10.0, 3.0, 1.0, 0.3, 0.1)
"""Tried one after the other, after whole runs."""
AS_LARGE = 1.0
"""Error of the best simulation, as a share of the recorded motion, above which a run says nothing more than its drift."""
FEWEST_ROWS = 4
"""Of a run."""

Machine = tuple[np.ndarray | None, tuple[EffectSetting, ...]]
"""Plant parameters (None: those of the file), and effects besides those that are known."""


@dataclass(frozen=True)
class Predicted:
    """Errors of free runs, or of rows that are predicted from those before them.

    Attributes
    ----------
    horizon_s : float or None
        Length of the runs; None: whole recordings.
    channels : mapping of str to mapping of str to float
        By channel and machine: rms error over the rms of the recording about its mean, or in units of noise where it is of rows; infinite
        where a simulation ended.
    errors_of : ErrorsOf
    squares : mapping of str to float
        What each machine leaves, in units of noise; none where that is not known.
    """

    horizon_s: float | None
    channels: Mapping[str, Mapping[str, float]]
    errors_of: ErrorsOf = "efforts"
    squares: Mapping[str, float] = field(default_factory=dict)

    @property
    def gained(self) -> float | None:
        """Twice the log likelihood that effects bring over numbers alone; None where it is not known."""
        return self.squares["retuned"] - self.squares["extended"] if self.squares else None


def predicted(
    trajectories: Sequence[Trajectory], noise: Mapping[str, float], machines: Mapping[str, Machine], judged: str
) -> Predicted | None:
    """Return the errors of free runs of some machines over the longest horizon over which one of them is near the recordings.

    Parameters
    ----------
    trajectories : sequence of Trajectory
    noise : mapping of str to float
        Standard deviation by channel, which is the table's machine "noise"; channels without it are left out.
    machines : mapping of str to Machine
    judged : str
        The machine whose errors choose the horizon.

    Returns
    -------
    Predicted or None
        None where no horizon is short enough.
    """
    channels = _channels(trajectories[0])
    runs = [Runs(trajectory) for trajectory in trajectories]
    spread = np.sqrt(np.nanmean(np.concatenate([(run.recorded - np.nanmean(run.recorded, axis=0)) ** 2 for run in runs]), axis=0))
    kept = [c for c in range(len(channels)) if spread[c] > 0.0 and channels[c] in noise]
    for horizon in (None, *HORIZONS_s):
        errors = _errors(runs, horizon, machines[judged], spread)
        if errors is not None and max(errors[kept], default=np.inf) < AS_LARGE:
            table: dict[str, dict[str, float]] = {channels[c]: {} for c in kept}
            for name, machine in machines.items():
                found = errors if name == judged else _errors(runs, horizon, machine, spread)
                for c in kept:
                    table[channels[c]][name] = np.inf if found is None else float(found[c])
            for c in kept:
                table[channels[c]]["noise"] = noise[channels[c]] / float(spread[c])
            return Predicted(horizon, table)
    return None


class Runs:
    """One recording, and free runs of its simulator beside it.

    Parameters
    ----------
    trajectory : Trajectory
    """

    def __init__(self, trajectory: Trajectory) -> None:
        observed = trajectory.observed
        machine = observed.machine
        plant = replace(machine.plant, sample_period_s=observed.period_s)
        self.simulator = Simulator(smooth(replace(machine, plant=plant, sample_rate_Hz=1.0 / observed.period_s, controllers=())))
        self.known = trajectory.known
        self.channels = _channels(trajectory)
        self.recorded = observed.readings[:, [observed.channels.index(channel) for channel in self.channels]]
        self.targets = observed.targets
        motion = efforts_by_encoders(trajectory)[0]
        driven = list(self.simulator.plant.joint_of_axis().values())
        self.position, self.speed = motion.position[:, driven], motion.speed[:, driven]
        self.passive, self.motion = self.simulator.plant.free_joints if trajectory.begins.any() else np.zeros(0, dtype=np.int64), motion
        self.speed_deviation = motion.speed_deviation[:, driven]
        self.position_deviation = np.array([trajectory.smooth[joint].noise if joint in trajectory.smooth else 0.0 for joint in driven])
        self.rows, self.period_s = observed.rows, observed.period_s

    def windows(self, horizon_s: float | None) -> list[tuple[int, int]]:
        """Return first rows, and the rows behind the last ones, of runs of this length, one after the other."""
        rows = self.rows if horizon_s is None else min(self.rows, max(FEWEST_ROWS, round(horizon_s / self.period_s)))
        return [(rows * k, rows * (k + 1)) for k in range(self.rows // rows)]

    def off(self, horizon_s: float | None, machine: Machine, shift: tuple[np.ndarray, np.ndarray] | None = None) -> list[np.ndarray] | None:
        """Return what the simulated windows are off by, (rows, C) each; None where one ends early.

        `shift` (windows, axes) are added to the positions and to the speeds that they begin from.
        """
        found = []
        for number, (begin, end) in enumerate(self.windows(horizon_s)):
            efforts = self.targets[begin:end]
            none = np.zeros_like(efforts)
            command = np.vstack([efforts[1:], efforts[-1:]])  # a command acts a row late
            position, speed = self.position[begin], self.speed[begin]
            if shift is not None:
                position, speed = position + shift[0][number], speed + shift[1][number]
            passive = (values[begin : begin + 1, self.passive] for values in (self.motion.position, self.motion.speed))
            restarts = Restarts(np.zeros(1, dtype=np.int64), self.passive, *passive) if len(self.passive) else None
            inputs = Inputs(None, none, none, command, position, start_speed=speed, first_effort=efforts[0], restarts=restarts)
            trial = machine[0], (*self.known, *machine[1])
            outputs = self.simulator.run_or_error(inputs, *trial) if restarts is None else self.simulator.run_all(inputs, [trial])[0]
            if not isinstance(outputs, Outputs):
                return None
            found.append(simulated_matrix(self.simulator.machine, outputs, self.channels) - self.recorded[begin:end])
        return found


def _errors(runs: Sequence[Runs], horizon_s: float | None, machine: Machine, spread: np.ndarray) -> np.ndarray | None:
    off: list[np.ndarray] = []
    for run in runs:
        found = run.off(horizon_s, machine)
        if found is None:
            return None
        off += found
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        errors: np.ndarray = np.sqrt(np.nanmean(np.concatenate(off) ** 2, axis=0)) / spread
    return errors if np.isfinite(errors[spread > 0.0]).all() else None


def _channels(trajectory: Trajectory) -> tuple[str, ...]:
    """Return the encoders and speed sensors that were recorded."""
    sensors = [sensor.channel for sensor in trajectory.settings.joint_sensors]
    return tuple(channel for channel in trajectory.observed.channels if channel in sensors)
