"""Free runs beside one recording, in windows of one length one after the other: each begins where the recording was."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from hil.diagnosis.observed.rows import Observed
from hil.diagnosis.residuals.trajectory import Trajectory
from hil.diagnosis.unknowns.unknowns import Machine
from hil.simulation import Inputs, Outputs, Simulator
from hil.simulation.inputs import Restarts
from hil.simulation.several import Own
from hil.simulation.smooth import simulated_matrix, smooth
from virtual_bus.settings import EffectSetting

ENDS = 8
"""Rows at the beginning of a recording, whose speeds are smoothed from one side: no window begins there."""
MOST_STEPS = 100
"""Within a plant step: a machine that moves so fast is at rest again before the next row, and costs what a hundred others do."""
Errors = tuple[np.ndarray, ...] | None
"""Simulated less recorded (rows, C), NaN where nothing was read, for windows of every length; None where the simulation ended early."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one length.

    Attributes
    ----------
    first : (W,) int array
        Their first rows.
    rows : int
    """

    first: np.ndarray
    rows: int

    @property
    def at(self) -> np.ndarray:
        """Rows (W rows,) of the recording, one window after the other."""
        return np.asarray((self.first[:, None] + np.arange(self.rows)).reshape(-1))


@dataclass(frozen=True, eq=False)
class Starts:
    """How far from the recorded states a machine begins its windows: one joint's position or speed.

    Attributes
    ----------
    position, speed : (joints,) arrays
    """

    position: np.ndarray
    speed: np.ndarray


class Simulated(Protocol):
    """Free runs beside one recording."""

    number: int
    channels: tuple[str, ...]
    recorded: np.ndarray
    period_s: float
    rows: int
    first_row: int
    noise: np.ndarray
    starts: tuple[Starts, ...]

    def begin(
        self, machines: Sequence[Machine], starts: Sequence[Starts | None], windows: Sequence[Windows], threads: ThreadPoolExecutor
    ) -> Callable[[], list[Errors]]:
        """Begin to run machines from the recorded states, or from states apart from these; return what waits for their errors."""


class OpenLoop:
    """Free runs driven by the recorded efforts, with no controller to keep them near the recording.

    Parameters
    ----------
    number : int
        Of the recording.
    observed : Observed
    trajectory : Trajectory
        Of the same: its smoothed motion says how fast windows begin.
    """

    def __init__(self, number: int, observed: Observed, trajectory: Trajectory) -> None:
        machine = observed.machine
        plant = replace(machine.plant, sample_period_s=observed.period_s, effects=())
        self.number = number
        self.known: tuple[EffectSetting, ...] = machine.plant.effects
        self.simulator = Simulator(smooth(replace(machine, plant=plant, sample_rate_Hz=1.0 / observed.period_s, controllers=())))
        sensors = {sensor.channel: sensor for sensor in machine.plant.joint_sensors}
        self.channels = tuple(channel for channel in observed.channels if channel in sensors)
        columns = [observed.channels.index(channel) for channel in self.channels]
        self.recorded = observed.readings[:, columns]
        self.period_s, self.rows = observed.period_s, observed.rows
        self.first_row = min(ENDS, self.rows // 2)
        self._targets, self._are_measured = observed.targets, observed.are_measured
        followed = sorted(trajectory.smooth)
        self._followed = np.array(followed, dtype=np.int64)
        self._position, self._speed = (
            np.column_stack([getattr(trajectory.smooth[j], name) for j in followed]) for name in ("position", "speed")
        )
        self._encoder = self._encoders(trajectory, followed)
        for f, c in self._encoder.items():  # as it was read: a smoothed position of a fast motion lags
            there = np.isfinite(self.recorded[:, c])
            self._position[there, f] = self.recorded[there, c]
        self.noise = np.array([self._noise(trajectory, channel) for channel in self.channels])
        joints = self.simulator.plant.joints
        begun = []
        for joint in followed:
            one = trajectory.smooth[joint]
            for name, size in (("position", one.noise), ("speed", float(np.median(one.speed_deviation)))):
                shift = {"position": np.zeros(joints), "speed": np.zeros(joints)}
                shift[name][joint] = max(size, 1e-12)
                begun.append(Starts(**shift))
        self.starts = tuple(begun)

    def _encoders(self, trajectory: Trajectory, followed: Sequence[int]) -> dict[int, int]:
        """Return, of the followed joints that have one of their own, the encoder's channel."""
        found: dict[int, int] = {}
        for encoder in trajectory.settings.encoders:
            if len(encoder.joints) == 1 and encoder.channel in self.channels:
                joint = trajectory.joints.index(encoder.joints[0])
                if joint in followed:
                    found.setdefault(followed.index(joint), self.channels.index(encoder.channel))
        return found

    def _noise(self, trajectory: Trajectory, channel: str) -> float:
        sensor = next(each for each in trajectory.settings.joint_sensors if each.channel == channel)
        joints = [trajectory.joints.index(joint) for joint in sensor.joints]
        if sensor not in trajectory.settings.encoders:
            c = self.channels.index(channel)
            moved = sum((trajectory.smooth[joint].speed for joint in joints if joint in trajectory.smooth), np.zeros(self.rows))
            return float(np.nanstd(self.recorded[:, c] - moved))
        return max((trajectory.smooth[joint].noise for joint in joints if joint in trajectory.smooth), default=sensor.resolution) + 1e-12

    def _efforts(self, lateness_s: float) -> np.ndarray:
        """Return what acts from each row to the next (N, axes).

        Measured efforts go along straight lines between their rows; a command is held.
        """
        if lateness_s == 0.0 and not self._are_measured.any():
            return self._targets
        times = np.arange(self.rows + 1) * self.period_s
        efforts = np.empty_like(self._targets)
        for axis, column in enumerate(self._targets.T):
            if self._are_measured[axis]:
                areas = 0.5 * (column + np.append(column[1:], column[-1])) * self.period_s
            else:
                areas = column * self.period_s
            impulses = np.concatenate([[0.0], np.cumsum(areas)])
            before = times - lateness_s
            passed = np.interp(before, times, impulses) + np.minimum(before, 0.0) * column[0]
            efforts[:, axis] = np.diff(passed) / self.period_s
        return efforts

    def begin(
        self, machines: Sequence[Machine], starts: Sequence[Starts | None], windows: Sequence[Windows], threads: ThreadPoolExecutor
    ) -> Callable[[], list[Errors]]:
        """Begin to run machines, as `Simulated` says: windows of all lengths one after the other, in one run."""
        rows = np.concatenate([each.at for each in windows])
        at = np.concatenate([each.first for each in windows])
        lengths = np.concatenate([np.full(len(each.first), each.rows) for each in windows])
        position, speed = self._position[at], self._speed[at]
        restarts = Restarts(np.cumsum(lengths) - lengths, self._followed, position, speed)
        driven = self.simulator.plant.driven_joints
        pose = np.zeros(len(driven))
        for axis, joint in enumerate(driven):
            if joint in self._followed:
                pose[axis] = position[0, int(np.flatnonzero(self._followed == joint)[0])]
        groups: dict[float, list[int]] = {}
        for k, machine in enumerate(machines):
            groups.setdefault(machine.lateness_s, []).append(k)
        waiting = []
        for lateness, members in groups.items():
            efforts = self._efforts(lateness)[rows]
            none, command = np.zeros_like(efforts), np.vstack([efforts[1:], efforts[-1:]])  # a command acts a row late
            inputs = Inputs(None, none, none, command, pose, first_effort=efforts[0], restarts=restarts)
            trials = [(machines[k].values, (*self.known, *machines[k].effects)) for k in members]
            own = [self._own(machines[k], starts[k]) for k in members]
            waiting.append((members, self.simulator.begin_all(inputs, trials, threads, own, MOST_STEPS)))
        return in_order(len(machines), waiting, lambda k, outputs: self._off(machines[k], outputs, windows))

    def _own(self, machine: Machine, start: Starts | None) -> Own:
        joints = self.simulator.plant.joints
        position, speed = np.zeros(joints), np.zeros(joints)
        if start is not None:
            position, speed = start.position.copy(), start.speed.copy()
        for f, c in self._encoder.items():
            position[self._followed[f]] -= machine.zeros.get((self.number, c), 0.0)
        axes = len(self.simulator.machine.axes)
        return Own(np.ones(axes), position, speed, np.zeros(axes))

    def _off(self, machine: Machine, outputs: object, windows: Sequence[Windows]) -> Errors:
        if not isinstance(outputs, Outputs):
            return None
        simulated = simulated_matrix(self.simulator.machine, outputs, self.channels)
        for c in range(len(self.channels)):
            simulated[:, c] += machine.zeros.get((self.number, c), 0.0)
        parts = np.split(simulated, np.cumsum([len(each.at) for each in windows])[:-1])
        return tuple(part - self.recorded[each.at] for part, each in zip(parts, windows, strict=True))


def in_order(
    count: int, waiting: Sequence[tuple[Sequence[int], Callable[[], list[Any]]]], off: Callable[[int, object], Errors]
) -> Callable[[], list[Errors]]:
    """Return what waits for groups of simulations and returns, in the order of their machines, what each errs by."""

    def ended() -> list[Errors]:
        found: list[Errors] = [None] * count
        for members, outputs in waiting:
            for k, one in zip(members, outputs(), strict=True):
                found[k] = off(k, one)
        return found

    return ended
