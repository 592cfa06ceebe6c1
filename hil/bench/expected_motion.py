"""What a machine file makes of a motion that was measured: the efforts of its drives, and the readings of its IMU."""

from __future__ import annotations

import numpy as np

from drivers.judging.drive import UNSURE
from drivers.judging.motion_means import ROWS, Expected, Expects, Means
from hil.bench.holding import Loads
from hil.machine import Machine
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.expectation import SCRATCH_ROWS, expecting
from virtual_bus.physics import Physics


def expectation_of(machine: Machine, model: Physics) -> Expects | None:
    """Return what the machine file makes of a motion; None where nothing is compared with it.

    The axis's joint moves as its motor side, the joint of its gear as the link does beyond that. Joints that no encoder follows rest. What
    holds an axis is expected in the middle of what the ranges of the file's effects let it be, and may differ by half of that.
    """
    judging = machine.judging
    tolerances = [each.load_tolerance for each in judging.drives]
    tolerances += [] if judging.imu is None else [judging.imu.force_tolerance, judging.imu.turn_tolerance]
    if not np.isfinite(tolerances).any():
        return None
    plant, settings = model.plant, machine.plant
    expect, work = expecting(plant), plant.new_work()
    names = [joint.name for joint in settings.tree.joints]
    joints = plant.driven_joints
    scale = np.array([drive.constant * drive.ratio for drive in settings.drives])
    gears = np.full(len(joints), -1)
    for axis, drive in zip(machine.axes, settings.drives, strict=True):
        link = next((encoder for encoder in settings.encoders if encoder.channel == f"link_position_{axis}"), None)
        behind = [] if link is None else [names.index(joint) for joint in link.joints if joint != drive.joint]
        if len(behind) == 1:
            gears[machine.axes.index(axis)] = behind[0]
    loads, channels = Loads(machine, model), imu_channel_names(settings)
    name = "" if judging.imu is None else judging.imu.sensor
    first = next((6 * number for number, imu in enumerate(settings.imus) if imu.name == name), None)

    motion, of_axes, of_imus = np.zeros((SCRATCH_ROWS, 1, plant.joints)), np.zeros((2, len(joints))), np.zeros((1, len(channels)))

    def expects(means: Means) -> Expected:
        expect(model.model, work, means.rows, joints, gears, scale, motion, of_axes, of_imus)
        least, most = loads.between_at(motion[0, 0]).T
        return Expected(
            of_axes[0] + 0.5 * (least + most),
            of_axes[1] + 0.5 * (most - least) / UNSURE,
            of_imus[0, first : first + 6].copy() if first is not None else np.zeros(0),
        )

    expects(Means(np.zeros((ROWS, len(joints)))))  # compiles everything before anything moves
    return expects
