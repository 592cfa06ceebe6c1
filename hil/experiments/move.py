"""A move from one pose to another, all axes arriving together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from controllers.errors import DesignError
from controllers.trajectory import move
from hil.errors import ExperimentError
from hil.experiments.metadata import experiment_metadata
from hil.experiments.plan import Plan, pose_array
from hil.experiments.safety import Safety
from hil.machine import Machine

UNHURRIED = 0.5
"""Share of the machine's speed, acceleration and jerk that a move uses: it need not be fast, and gravity takes part of the effort."""


@dataclass(frozen=True)
class Move:
    """A move from pose to pose at half the machine's pace, by which the bench reaches an experiment's start.

    Parameters
    ----------
    start, goal : mapping
        Positions by axis name [rad or m]; axes left out stand at zero.

    Examples
    --------
    >>> import hil
    >>> (plan,) = hil.Move({}, {"turn": 0.5}).plans(hil.open_machine("turntable"))
    >>> plan.reference[[0, -1]].tolist()
    [[0.0], [0.5]]
    """

    start: Mapping[str, float]
    goal: Mapping[str, float]

    def plans(self, machine: Machine) -> list[Plan]:
        """Make the one plan of this experiment."""
        start, goal = pose_array(machine, self.start), pose_array(machine, self.goal)
        limits = tuple(
            replace(each, speed=UNHURRIED * each.speed, acceleration=UNHURRIED * each.acceleration, jerk=UNHURRIED * each.jerk)
            for each in machine.limits
        )
        try:
            reference = move(start, goal, limits, machine.sample_rate_Hz).position
        except DesignError as error:
            raise ExperimentError(f"move: {error}") from None
        safety = Safety(machine, start)
        safety.check_reference("move", reference)
        peaks = safety.check_motion("move", reference)
        metadata = experiment_metadata("move", period_samples=len(reference), settle_periods=0, periods=1, start_pose=start)
        return [safety.plan(reference, np.zeros_like(reference), start, metadata, (peaks,))]
