"""Objects that a drive's maker numbers as an IMU's are not an IMU's readings, neither when they come nor when they are missing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scripted_nodes import machine_settings

from drivers.canopen.can_imu import COUNTER, FORCE
from drivers.canopen.process_data import AxisInput, Tpdo
from drivers.interface import Sample
from drivers.settings import Pdo


@pytest.mark.parametrize("comes", [True, False])
def test_a_drives_own_objects_leave_the_imus_readings_alone(comes: bool) -> None:
    settings = machine_settings()
    pdo = Pdo(1, 0x181, 1, ((0x6041, 0, 16), (FORCE, 1, 16), (COUNTER, 0, 16)))
    tpdo = Tpdo(dataclasses.replace(settings.nodes[0], tpdos=(pdo,)), pdo, 0, AxisInput(settings.scalings[0]))
    sample = Sample(2)
    sample.bus_imu[:], sample.bus_imu_counter = np.arange(6.0), 7
    if comes:
        assert tpdo.take(bytes([0x27, 0x06, 1, 2, 3, 4]), sample)
        assert sample.statusword[0] == 0x0627
    else:
        tpdo.forget(sample, late=False)
        assert sample.statusword[0] == -1
    assert sample.bus_imu.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert sample.bus_imu_counter == 7
