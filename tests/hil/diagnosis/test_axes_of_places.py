"""Which axis a place or a channel belongs to, where one axis's name ends in another's."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.io

from hil.diagnosis.residuals.repeat_group import RepeatGroup
from hil.diagnosis.starting.motion import Motion
from hil.machine import machine_from_text
from hil.recording import read_recording
from hil.simulation import Inputs
from virtual_bus.plant.compiled import compile_plant

TWO_AXES = """
format = 1
name = "two_axes"
description = "A turning arm on a slide; the arm's axis is called after the slide's"
gravity_m_s2 = [0.0, 0.0, 0.0]

[timing]
sample_rate_Hz = 200.0
substeps = 2

[[body]]
name = "slide"
parent = "world"
mass_kg = 20.0
[body.joint]
name = "lift"
type = "prismatic"
axis = [0.0, 0.0, 1.0]

[[body]]
name = "arm_z"
parent = "slide"
mass_kg = 2.0
inertia_kg_m2 = [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]
[body.joint]
name = "turn"
type = "revolute"
axis = [0.0, 0.0, 1.0]

[drives.z]
joint = "lift"
effort_unit = "N"
constant = 1.0
constant_unit = "N/N"
limit_N = 10.0

[drives.fine_z]
joint = "turn"
effort_unit = "Nm"
constant = 1.0
constant_unit = "Nm/Nm"
limit_Nm = 10.0

[sensors.position_z]
type = "encoder"
joints = ["lift"]
kind = "incremental"
resolution_um = 0.0

[sensors.link_position_fine_z]
type = "encoder"
joints = ["turn"]
kind = "incremental"
resolution_rad = 0.0

[sensors.imu]
type = "imu"
body = "arm_z"
position_m = [0.0, 0.0, 0.0]
orientation_rad = [0.0, 0.0, 0.0]
accelerometer_bandwidth_Hz = 50.0
gyro_bandwidth_Hz = 50.0
"""


@pytest.fixture(scope="module")
def machine():
    return machine_from_text(TWO_AXES)


PLACES = {"z": 0, "fine_z": 1, "position_z": 0, "link_position_fine_z": 1, "effort_fine_z": 1, "slide": 0, "arm_z": 1}


@pytest.mark.parametrize(("at", "axis"), PLACES.items())
def test_a_place_is_of_the_axis_that_it_names_or_hangs_on(machine, at, axis):
    still = np.zeros((100, 2))
    inputs = Inputs(None, still, still, still, np.zeros(2))
    group = RepeatGroup(("r",), machine, inputs, (slice(0, 100),), np.arange(100) / 200.0, still[None], still, *[still] * 4)
    motion = Motion(machine, compile_plant(machine.plant).nominal, group, ("position_z", "link_position_fine_z"))
    assert motion.axis_of(at) == axis


def test_variables_of_a_mat_have_their_own_axis_s_units(machine, tmp_path):
    names = {"position_z": "m", "effort_z": "N", "link_position_fine_z": "rad", "effort_fine_z": "Nm", "imu_z": "m/s^2", "gyro_z": "rad/s"}
    scipy.io.savemat(tmp_path / "x.mat", {"time": [0.0, 0.5], **{name: [0.1, 0.2] for name in names}})
    found = read_recording(tmp_path / "x.mat", machine).channels
    assert {name: found[name].unit for name in names} == names
