"""A sweep of one axis at constant speed, as in an image acquisition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from controllers.errors import DesignError
from controllers.settings import AxisLimits
from controllers.trajectory import sweep
from hil.errors import ExperimentError
from hil.experiments.metadata import experiment_metadata
from hil.experiments.plan import Plan, axis_indices, check_duration, pose_array
from hil.experiments.safety import Safety
from hil.machine import Machine


@dataclass(frozen=True)
class Scan:
    """Jerk-limited sweeps of one axis.

    Parameters
    ----------
    axis : str
    start, stop : float
        Ends [rad or m].
    speed : float
        Speed of the constant part [rad/s or m/s]; 30 deg/s unless given.
    pose : mapping
        Positions of the other axes [rad or m]; those left out stand at zero.
    dwell_s : float
        Standstill before the first sweep and after each.
    sweeps : int
        1: forth; 2: forth and back; and so on. Every forth and back is a period of the recording.
    acceleration : float, optional
        Acceleration of the ramps [rad/s^2 or m/s^2]; the axis's limit unless given.
    """

    axis: str
    start: float
    stop: float
    speed: float = np.radians(30.0)
    pose: Mapping[str, float] = field(default_factory=dict)
    dwell_s: float = 1.0
    sweeps: int = 1
    acceleration: float | None = None

    def plans(self, machine: Machine) -> list[Plan]:
        """Make the one plan of this experiment."""
        if self.sweeps < 1:
            raise ExperimentError(f"scan: sweeps = {self.sweeps}: must be at least 1")
        if not 0.0 <= self.dwell_s < 1e6:
            raise ExperimentError(f"scan: dwell_s = {self.dwell_s:g}: must not be negative")
        axis = int(axis_indices(machine, (self.axis,))[0])
        start = pose_array(machine, {**self.pose, self.axis: self.start})
        if self.speed > 0.0:  # another is refused below
            each_s = abs(self.stop - self.start) / self.speed + self.dwell_s
            check_duration("scan", self.sweeps * each_s, f"{self.sweeps} sweeps of {each_s:.3g} s, standstill included")
        try:
            there = sweep(axis, start, self.stop, self.speed, self._limits(machine, axis), machine.sample_rate_Hz).position
        except DesignError as error:
            raise ExperimentError(f"scan: {error}") from None
        reference = self._with_dwells(there, machine.sample_rate_Hz)
        safety = Safety(machine, start)
        safety.check_reference("scan", reference)
        peaks = safety.check_motion("scan", reference)
        returns = self.sweeps // 2 if self.sweeps % 2 == 0 else 1
        metadata = experiment_metadata(
            "scan", period_samples=len(reference) // returns, settle_periods=0, periods=returns, start_pose=start
        )
        return [safety.plan(reference, np.zeros_like(reference), start, metadata, (peaks,))]

    def _limits(self, machine: Machine, axis: int) -> tuple[AxisLimits, ...]:
        limit = machine.limits[axis]
        if self.acceleration is None:
            return machine.limits
        if not 0.0 < self.acceleration <= limit.acceleration:
            raise ExperimentError(f"scan: acceleration = {self.acceleration:g}: must be positive and at most {limit.acceleration:.5g}")
        gentler = replace(limit, acceleration=self.acceleration)
        return (*machine.limits[:axis], gentler, *machine.limits[axis + 1 :])

    def _with_dwells(self, there: np.ndarray, sample_rate_Hz: float) -> np.ndarray:
        """Join dwell, sweep, dwell, sweep back: a period is forth, dwell, back, dwell, and starts within its first dwell."""
        rows = round(self.dwell_s * sample_rate_Hz)
        blocks = []
        for number in range(self.sweeps):
            way = there if number % 2 == 0 else there[::-1]
            blocks += [np.tile(way[0], (rows, 1)), way]
        if self.sweeps % 2:
            blocks.append(np.tile(blocks[-1][-1], (rows, 1)))
        return np.vstack(blocks)
