"""The machine as free runs take it, without lattices, and its simulated channels by name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hil.machine import Machine
from hil.recording.channels import imu_channels
from hil.simulation.simulator import Outputs

LARGEST_STEP_s = 1.0 / 500.0
"""Of the plant's integration."""


def smooth(machine: Machine, finer: int = 1, rounded: str | None = None) -> Machine:
    """Return the same machine without the lattices of its sensors and targets, in plant steps of at most LARGEST_STEP_s over `finer`.

    Rounding is noise to a recording, and it hides what a small change of a parameter does: a sensitivity through a coarse encoder is zero
    or a jump. The axis `rounded` keeps its encoders' lattices and its target's.
    """
    plant = machine.plant
    kept = (f"position_{rounded}", f"link_position_{rounded}")
    return replace(
        machine,
        plant=replace(
            plant,
            substeps=finer * math.ceil(plant.sample_period_s / LARGEST_STEP_s - 1e-9),
            drives=tuple(drive if drive.axis == rounded else replace(drive, resolution=0.0) for drive in plant.drives),
            encoders=tuple(one if one.channel in kept else replace(one, resolution=0.0) for one in plant.encoders),
            currents=tuple(replace(current, resolution=0.0) for current in plant.currents),
            speeds=tuple(replace(sensor, resolution=0.0) for sensor in plant.speeds),
            imus=tuple(replace(imu, accelerometer_resolution_m_s2=0.0, gyro_resolution_rad_s=0.0) for imu in plant.imus),
        ),
    )


def channel_outputs(machine: Machine, outputs: Outputs) -> dict[str, np.ndarray]:
    """Return simulated channels by name, each (N,); those alone that the machine has."""
    channels = {name: getattr(outputs, kind)[:, column] for name, (kind, column) in _columns(machine).items()}
    return {name: values for name, values in channels.items() if not np.isnan(values).all()}


def _columns(machine: Machine) -> dict[str, tuple[str, int]]:
    """Where the outputs have every channel: which of them, and its column."""
    columns: dict[str, tuple[str, int]] = {}
    for i, units in enumerate(machine.units):
        columns[f"{'current' if units.effort == 'A' else 'effort'}_{units.axis}"] = "effort", i
        columns[f"command_{units.axis}"] = "command", i
        columns[f"position_{units.axis}"] = "position", i
        columns[f"link_position_{units.axis}"] = "link_position", i
        columns[f"speed_{units.axis}"] = "speed", i
    names = [name for imu in machine.plant.imus for name in imu_channels(imu.name)]
    columns.update((name, ("imu", column)) for column, name in enumerate(names))
    return columns


def simulated_matrix(machine: Machine, outputs: Outputs, channels: Sequence[str]) -> np.ndarray:
    """(N, C) simulated channels in this order."""
    columns = _columns(machine)
    matrix = np.empty((len(outputs.command), len(channels)))
    for number, (kind, column) in enumerate(columns[name] for name in channels):
        matrix[:, number] = getattr(outputs, kind)[:, column]
    return matrix
