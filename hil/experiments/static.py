"""Standstill under control, for noise, drift and holding effort."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from hil.errors import ExperimentError
from hil.experiments.metadata import experiment_metadata
from hil.experiments.plan import Plan, pose_array
from hil.experiments.safety import Safety
from hil.machine import Machine


@dataclass(frozen=True)
class Static:
    """Hold a pose.

    Parameters
    ----------
    seconds : float
    pose : mapping
        Position by axis name [rad or m]; axes left out stand at zero.
    """

    seconds: float = 10.0
    pose: Mapping[str, float] = field(default_factory=dict)

    def plans(self, machine: Machine) -> list[Plan]:
        """Make the one plan of this experiment."""
        rows = round(self.seconds * machine.sample_rate_Hz) if 0.0 < self.seconds < 1e6 else 0
        if rows < 1:
            raise ExperimentError(f"static: seconds = {self.seconds:g}: must be positive, at most a million")
        pose = pose_array(machine, self.pose)
        reference = np.tile(pose, (rows, 1))
        safety = Safety(machine, pose)
        safety.check_stability()
        metadata = experiment_metadata("static", period_samples=rows, settle_periods=0, periods=1, start_pose=pose)
        return [safety.plan(reference, np.zeros_like(reference), pose, metadata)]
