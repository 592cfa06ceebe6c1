"""A first controller for every axis: integrator, gain and lead, at the highest crossover that leaves the margins of `machine check`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from controllers.loop_shaping import cascade, lag, lead
from controllers.sections import response
from controllers.settings import AxisController
from hil.machine.check import failing_controllers, pose_grid
from hil.machine.machine import Machine

HIGHEST_SHARE = 0.02
"""Of the sample rate: a crossover there loses 11 degrees to the delay of a sample and a half."""
LOWEST_Hz = 0.05
STEP = 0.8
PHASE_deg = 60.0
INTEGRATOR_SHARE = 0.04
"""Corner of the integrator over the crossover: it costs 2.3 degrees."""
POSES = 27
DIGITS = 10


def designed(machine: Machine) -> dict[str, np.ndarray] | None:
    """Return second-order sections (2, 6) per axis, or None where no crossover leaves the margins.

    All axes go to lower crossovers together, by a factor of 0.8, until `machine check` would pass them.
    """
    from virtual_bus.physics import Physics  # here because it compiles the plant

    physics = Physics(machine.plant, noise=False)
    plants = [physics.linearise(np.array(pose)) for pose in pose_grid(machine, POSES)]
    crossover_Hz = HIGHEST_SHARE * machine.sample_rate_Hz
    while crossover_Hz > LOWEST_Hz:
        sections = {axis: _sections(plants, axis, crossover_Hz, machine.sample_rate_Hz) for axis in machine.axes}
        controllers = tuple(
            AxisController(axis, sections[axis], None, drive.limit, gravity_feedforward=False)
            for axis, drive in zip(machine.axes, machine.plant.drives, strict=True)
        )
        if not failing_controllers(replace(machine, controllers=controllers), POSES):
            return sections
        crossover_Hz *= STEP
    return None


def _sections(plants: list, axis: str, crossover_Hz: float, rate_Hz: float) -> np.ndarray:  # type: ignore[type-arg]
    """Return the sections that bring the loop's gain to 1 at the crossover in the pose where the plant's is largest."""
    largest = max(abs(complex(plant[f"position_{axis}", f"command_{axis}"](2j * np.pi * crossover_Hz))) for plant in plants)
    shape = cascade(lag(0.0, INTEGRATOR_SHARE * crossover_Hz, rate_Hz), lead(crossover_Hz, PHASE_deg, rate_Hz))
    size = float(np.abs(response(shape, np.array([crossover_Hz]), rate_Hz))[0])
    scaled = cascade(shape)
    scaled[0, :3] *= 1.0 / (largest * size)
    rounded = np.array([[float(f"{number:.{DIGITS}g}") for number in row] for row in scaled])
    return rounded
