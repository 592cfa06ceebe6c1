"""A tour from stop to stop with a standstill at each, for calibration scans and roadmapping grids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from controllers.errors import DesignError
from controllers.trajectory import move
from hil.errors import ExperimentError
from hil.experiments.metadata import experiment_metadata
from hil.experiments.plan import Plan, check_duration, pose_array
from hil.experiments.safety import Safety
from hil.machine import Machine


@dataclass(frozen=True)
class Tour:
    """Jerk-limited moves between stops, all axes of a move arriving together.

    Parameters
    ----------
    stops : tuple of mapping
        Positions by axis name [rad or m]; an axis left out stays where it was, at the first stop at zero.
    pace : float
        Share of the machine's limits on speed, acceleration and jerk that every way takes.
    dwell_s : float
        Standstill at each stop.
    """

    stops: tuple[Mapping[str, float], ...]
    pace: float = 0.2
    dwell_s: float = 1.0

    def plans(self, machine: Machine) -> list[Plan]:
        """Make the one plan of this experiment."""
        if len(self.stops) < 2:
            raise ExperimentError(f"tour: {len(self.stops)} stops: must be two at least")
        if not 0.0 < self.pace <= 1.0:
            raise ExperimentError(f"tour: pace = {self.pace:g}: must be above 0 and at most 1")
        if not self.dwell_s >= 0.0:
            raise ExperimentError(f"tour: dwell_s = {self.dwell_s:g}: must not be negative")
        limits = tuple(
            replace(each, speed=self.pace * each.speed, acceleration=self.pace * each.acceleration, jerk=self.pace * each.jerk)
            for each in machine.limits
        )
        here = start = pose_array(machine, self.stops[0])
        check_duration("tour", self._least_s(machine), f"pace = {self.pace:g}, dwell_s = {self.dwell_s:g}")
        still = round(self.dwell_s * machine.sample_rate_Hz)
        blocks = [np.tile(start, (still, 1))]
        for stop in self.stops[1:]:
            named = pose_array(machine, stop)
            there = np.array([named[k] if axis in stop else here[k] for k, axis in enumerate(machine.axes)])
            if not np.array_equal(here, there):
                try:
                    blocks.append(move(here, there, limits, machine.sample_rate_Hz).position)
                except DesignError as error:
                    raise ExperimentError(f"tour: {error}") from None
            blocks.append(np.tile(there, (still, 1)))
            here = there
        reference = np.vstack(blocks)
        if not len(reference):
            raise ExperimentError("tour: dwell_s = 0 and one pose throughout: must dwell, or go somewhere")
        safety = Safety(machine, start)
        safety.check_reference("tour", reference)
        peaks = safety.check_motion("tour", reference)
        metadata = experiment_metadata("tour", period_samples=len(reference), settle_periods=0, periods=1, start_pose=start)
        return [safety.plan(reference, np.zeros_like(reference), start, metadata, (peaks,))]

    def _least_s(self, machine: Machine) -> float:
        """Return the least duration: standstills, and every move at the pace's speed without the time of acceleration."""
        way_s, here = 0.0, pose_array(machine, self.stops[0])
        for stop in self.stops[1:]:
            named = pose_array(machine, stop)
            there = np.array([named[k] if axis in stop else here[k] for k, axis in enumerate(machine.axes)])
            way_s += max(abs(there[k] - here[k]) / (self.pace * limit.speed) for k, limit in enumerate(machine.limits))
            here = there
        return way_s + self.dwell_s * len(self.stops)
