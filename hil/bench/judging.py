"""The judgement of a machine's sensors: how fast its encoders can move, and what a recording says of sensors found wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.judging.judge import Finding
from drivers.judging.settings import EncoderJudging, JudgingSettings
from hil.bench.expected_motion import expectation_of
from hil.machine import Machine
from virtual_bus.physics import Physics
from virtual_bus.plant.linearise import inertia_matrix

EFFORT_MARGIN = 2.0
"""Multiple of the drive's greatest effort that acts on an encoder's joints at most: the drive's own, and as much from a spring that it has
wound up."""


def judging_of(machine: Machine, model: Physics, *, noise: bool = True) -> JudgingSettings:
    """Return what is judged in a run of this machine.

    Parameters
    ----------
    machine : Machine
    model : Physics
        Of the machine file.
    noise : bool
        False where the machine is emulated without noise: readings that do not change are then sound.
    """
    inverse = np.linalg.inv(inertia_matrix(model.plant, model.model, np.zeros(model.plant.joints)))
    weights = {encoder.channel: _weights(machine, encoder.joints) for encoder in machine.plant.encoders}
    imu = machine.judging.imu
    if imu is not None and not noise:
        imu = dataclasses.replace(imu, frozen_packets=(0,) * 6)
    encoders = tuple(_moving(machine, each, weights, inverse) for each in machine.judging.encoders)
    return dataclasses.replace(machine.judging, imu=imu, encoders=encoders, expects=expectation_of(machine, model))


def judged_table(sensors: Sequence[str], findings: Sequence[Finding] = ()) -> dict[str, Any]:
    """Return the metadata's table `judged`: the sensors in the order of the bits of `sensor_marks`, and what was found of them."""
    return {"sensors": list(sensors), "findings": [dataclasses.asdict(finding) for finding in findings]}


def judged_lines(findings: Sequence[Finding], rows: int) -> tuple[str, ...]:
    """Return a line per finding, in words."""
    return tuple(
        f"{finding.sensor}: {finding.says} (from {finding.since_s:.3f} s on; {finding.rows} of {rows} rows are marked)"
        for finding in findings
    )


def _weights(machine: Machine, joints: Sequence[str]) -> np.ndarray:
    """Return what each joint counts in an encoder's sum, (n,)."""
    return np.array([float(joint.name in joints) for joint in machine.plant.tree.joints])


def _moving(machine: Machine, encoder: EncoderJudging, weights: dict[str, np.ndarray], inverse: np.ndarray) -> EncoderJudging:
    """Return an axis's settings with its inertia, and with the accelerations that no effort exceeds.

    An effort on the joints w that an encoder sums moves it by w' M^-1 w per unit at once, while all springs are as they were.
    """
    axis = machine.axes[encoder.axis]
    drive = machine.plant.drives[encoder.axis]
    greatest = EFFORT_MARGIN * drive.limit * encoder.effort_scale
    motor = weights[f"position_{axis}"]
    link = weights.get(f"link_position_{axis}", motor)
    mobility = float(motor @ inverse @ motor)
    return dataclasses.replace(
        encoder,
        motor_acceleration=greatest * mobility,
        link_acceleration=greatest * float(link @ inverse @ link),
        inertia=1.0 / mobility,
    )
