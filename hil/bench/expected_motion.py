"""What a machine file makes of a motion that was measured: the efforts of its drives, and the readings of its IMU."""

from __future__ import annotations

import numpy as np

from drivers.judging.drive import UNSURE
from drivers.judging.motion_window import Expected, Expects, Means
from hil.bench.holding import Loads
from hil.machine import Machine
from virtual_bus.effects.places import imu_channel_names
from virtual_bus.inverse_dynamics import along_module
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
    loads, channels = Loads(machine, model), imu_channel_names(settings)
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
        least, most = loads.between_at(motion[0][0]).T
        return Expected(
            (needed + friction)[0, joints] / scale + 0.5 * (least + most),
            np.sqrt(variance[0, joints]) / scale + 0.5 * (most - least) / UNSURE,
            imu[0, first : first + 6] if first is not None else np.zeros(0),
        )

    still = np.zeros((2, len(joints)))
    expects(Means(still, still, still, still[0], still[0]))  # compiles everything before anything moves
    return expects
