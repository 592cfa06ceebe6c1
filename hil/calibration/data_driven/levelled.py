"""Inertial measurements as a machine without offsets would have made them.

An accelerometer on a machine with a mounting offset of a milliradian reads the same as on one that is bent by a milliradian, and an
observer that knows only the drawing's geometry assumes the latter. Once images have determined the offsets, the readings are turned back by
them: f' = f + w x f, with w the turn that the offsets, not gravity, give the detector in the pose of the row.
"""

from __future__ import annotations

import numpy as np

from hil.calibration.data_driven.quasi_static import QuasiStatic
from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.recording import Channel, Recording
from hil.recording.channels import imu_channels

NOT_OFFSETS = ("detector_sag", "source_sag", "mount_yield")
"""Not offsets: bending by gravity is estimated by the observer."""


def levelled(machine: Machine, recording: Recording, model: QuasiStatic, values: np.ndarray) -> Recording:
    """Return the recording with its detector's inertial measurements turned back by the offsets among the parameters (p,).

    Raises
    ------
    UnusableInputError
        The machine has no IMU.
    """
    if not machine.plant.imus:
        raise UnusableInputError(f"{machine.name}: has no IMU; there is nothing to turn back")
    imu = machine.plant.imus[0]
    six = imu_channels(imu.name)
    names = [six[:3], six[3:]]
    positions = recording.matrix([f"position_{axis}" for axis in machine.axes])
    load = np.broadcast_to(machine.plant.tree.gravity_m_s2 / np.linalg.norm(machine.plant.tree.gravity_m_s2), (len(positions), 3))
    offsets = np.where([name.startswith(NOT_OFFSETS) for name in model.names], 0.0, values)
    turn = np.full((len(positions), 3), np.nan)
    known = np.isfinite(positions).all(axis=1)
    turn[known] = (model.rows(positions[known], load[known]) @ offsets)[:, 6:]
    channels = dict(recording.channels)
    for group in names:
        if not all(name in recording for name in group):
            continue
        own = recording.matrix(group) @ imu.orientation.T  # in the detector's frame
        turned = (own + np.cross(turn, own)) @ imu.orientation
        for name, column in zip(group, turned.T, strict=True):
            channels[name] = Channel(recording.channels[name].unit, column)
    return Recording(channels, recording.metadata)
