"""What size things have at a place: what starts take where a guess sees nothing."""

from __future__ import annotations

import numpy as np

from hil.diagnosis.starting.motion import Motion
from virtual_bus.effects.effect import Parameter
from virtual_bus.effects.places import joint_at, undriven_joint_at
from virtual_bus.effects.residual import Residual

FIRST_SHARE = 0.1
"""Strength of a first try where a guess sees nothing, as a share of what the machine shows of its kind."""

Start = dict[str, float]
"""Values of an effect's parameters by their names."""


class Typical:
    """What size things have at a place."""

    def __init__(self, motion: Motion, at: str, residual: Residual) -> None:
        self.motion, self.at = motion, at
        self.sample_s = 1.0 / motion.machine.sample_rate_Hz
        self.duration_s = float(residual.time_s[-1] - residual.time_s[0])
        self.travel = max(float(np.ptp(residual.position)), 1e-6)
        self.speed = max(float(np.abs(residual.speed).max()), 1e-6)
        self.acceleration = max(float(np.sqrt(np.mean(residual.acceleration**2))), 1e-6)
        drive = FIRST_SHARE * float(np.sqrt(np.mean(residual.drive_effort**2)))
        self.effort = max(2.0 * float(np.sqrt(np.mean(residual.effort**2))), drive, 1e-9)
        self.stiffness = residual.stiffness
        self.deflection = max(float(np.abs(residual.other_position).max()), 1e-12) if residual.stiffness > 0.0 else self.travel
        self.current = max(float(np.abs(residual.current).max()), 1e-6)
        settings = motion.machine.plant
        self.mass = next((body.mass_kg for body in settings.tree.bodies if body.name == at), 1.0)
        self.inertia = self._inertia()
        self.swing = self.travel if undriven_joint_at(at, settings) is None else 2.0 * self.deflection
        own = next((imu.accelerometer_bandwidth_Hz or imu.gyro_bandwidth_Hz for imu in settings.imus if imu.name == at), 0.0)
        self.low_pass_Hz = own or 0.2 / self.sample_s

    def _inertia(self) -> float:
        """Of the joint a place belongs to, about the mean pose."""
        plant = self.motion.plant
        try:
            joint = plant.settings.tree.joint_index(joint_at(self.at, plant.settings))
        except (StopIteration, AssertionError):
            joint = list(plant.joint_of_axis().values())[self.motion.axis_of(self.at)]
        return float(self.motion.inertia[joint])

    def of(self, parameter: Parameter) -> float:
        """A first strength of this unit."""
        return {
            "Nm": self.effort,
            "Nm/rad": self.effort / self.travel,
            "Nm s/rad": self.effort / self.speed,
            "Nm s^2/rad^2": self.effort / self.speed**2,
            "Nm/rad^3": self.effort / self.deflection**3,
            "kg m^2": FIRST_SHARE * self.inertia,
            "kg": FIRST_SHARE * self.mass,
            "rad": FIRST_SHARE * self.deflection if self.stiffness > 0.0 else 1e-3 * self.travel,
            "rad/Nm": FIRST_SHARE / self.stiffness if self.stiffness > 0.0 else 0.0,
            "rad/s": 1e-2,
            "m/s^2": 2e-2,
            "s": self.sample_s,
            "Hz": 0.1 / self.sample_s,
            "A": 0.9 * self.current,
            "phase": 0.01,
        }.get(parameter.unit, 0.02)
