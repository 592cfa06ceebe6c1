"""The judgement of a machine's sensors: how fast its encoders can move, and what a recording says of sensors found wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.judging.judge import Finding
from drivers.judging.motion_window import Expected, Expects, Means
from drivers.judging.settings import EncoderJudging, JudgingSettings
from hil.machine import Machine
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.physics import Physics
from virtual_bus.plant.along import along_module
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
    return dataclasses.replace(machine.judging, imu=imu, encoders=encoders, expects=_expects(machine, model))


def judged_table(sensors: Sequence[str], findings: Sequence[Finding] = ()) -> dict[str, Any]:
    """Return the metadata's table `judged`: the sensors in the order of the bits of `sensor_marks`, and what was found of them."""
    return {"sensors": list(sensors), "findings": [dataclasses.asdict(finding) for finding in findings]}


def judged_lines(findings: Sequence[Finding], rows: int) -> tuple[str, ...]:
    """Return a line per finding, in words."""
    return tuple(
        f"{finding.sensor}: {finding.says} (from {finding.since_s:.3f} s on; {finding.rows} of {rows} rows are marked)"
        for finding in findings
    )


def _expects(machine: Machine, model: Physics) -> Expects | None:
    """Return what the machine file makes of a motion; None where nothing is compared with it.

    The axis's joint moves as its motor side, the joint of its gear as the link does beyond that. Joints that no encoder follows rest.
    """
    judging = machine.judging
    tolerances = [each.load_tolerance for each in judging.drives]
    tolerances += [] if judging.imu is None else [judging.imu.force_tolerance, judging.imu.turn_tolerance]
    if not np.isfinite(tolerances).any():
        return None
    plant, settings = model.plant, machine.plant
    module, work = along_module(plant), plant.new_work()
    names = [joint.name for joint in settings.tree.joints]
    joints = [names.index(drive.joint) for drive in settings.drives]
    scale = np.array([drive.constant * drive.ratio for drive in settings.drives])
    gears = {}
    for axis, drive in zip(machine.axes, settings.drives, strict=True):
        link = next((encoder for encoder in settings.encoders if encoder.channel == f"link_position_{axis}"), None)
        behind = [] if link is None else [names.index(joint) for joint in link.joints if joint != drive.joint]
        if len(behind) == 1:
            gears[machine.axes.index(axis)] = behind[0]
    channels = imu_channel_names(settings)
    name = "" if judging.imu is None else judging.imu.sensor
    first = next((6 * number for number, imu in enumerate(settings.imus) if imu.name == name), None)

    def spread(both: np.ndarray) -> np.ndarray:
        values = np.zeros((1, plant.joints))
        values[0, joints] = both[0]
        for axis, gear in gears.items():
            values[0, gear] = both[1, axis] - both[0, axis]
        return values

    def expects(means: Means) -> Expected:
        motion = [spread(both) for both in (means.position, means.speed, means.acceleration)]
        needed, friction, variance = (np.zeros((1, plant.joints)) for _ in range(3))
        module.efforts(model.model, work, *motion, needed)
        given, deviation = np.zeros((1, plant.joints)), np.zeros((1, plant.joints))
        given[0, joints], deviation[0, joints] = scale * means.effort, means.deviation
        module.rub(model.model, work, motion[0], motion[1], deviation, given, friction, variance)
        imu = np.zeros((1, len(channels)))
        if channels:
            module.readings(model.model, work, *motion, imu)
        return Expected(
            (needed + friction)[0, joints] / scale,
            np.sqrt(variance[0, joints]) / scale,
            imu[0, first : first + 6] if first is not None else np.zeros(0),
        )

    still = np.zeros((2, len(joints)))
    expects(Means(still, still, still, still[0], still[0]))  # compiles everything before anything moves
    return expects


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
