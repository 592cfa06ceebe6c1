"""The exported MuJoCo model bears the machine file's names and the recording's channels."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from hil.machine.load import load_machine
from hil.machine.mjcf import to_mjcf
from virtual_bus.physics import Physics

POSE = np.array([0.3, -0.4])


@pytest.fixture(scope="module")
def exported() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(to_mjcf(load_machine("carm").plant, "carm"))


def test_names_are_those_of_the_machine_file_and_the_channels(exported: mujoco.MjModel) -> None:
    settings = load_machine("carm").plant
    assert [exported.body(k).name for k in range(1, exported.nbody)] == [body.name for body in settings.tree.bodies]
    assert [exported.joint(k).name for k in range(exported.njnt)] == [joint.name for joint in settings.tree.joints]
    assert [exported.actuator(k).name for k in range(exported.nu)] == ["propeller", "roll"]
    names = {exported.sensor(k).name for k in range(exported.nsensor)}
    assert {"imu", "gyro", "current_propeller", "current_roll"} | {e.channel for e in settings.encoders} <= names


def test_its_sensors_read_what_the_emulated_machine_reads_at_rest(exported: mujoco.MjModel) -> None:
    settings = load_machine("carm").plant
    physics = Physics(settings, noise=False)
    physics.place(POSE)
    effort = physics.holding_effort(POSE)
    physics.apply(effort)
    data = mujoco.MjData(exported)
    data.qpos[:] = physics.truth()["joint_position"]
    data.ctrl[:] = effort
    mujoco.mj_forward(exported, data)
    latched = physics.latch()
    for axis, name in enumerate(physics.axes):
        assert data.sensor(f"position_{name}").data[0] == pytest.approx(latched.position[axis], abs=1e-4)
        assert data.sensor(f"link_position_{name}").data[0] == pytest.approx(latched.link_position[axis], abs=1e-5)
        assert data.sensor(f"current_{name}").data[0] == pytest.approx(effort[axis], rel=1e-12)
    imu = settings.imus[0]
    force = latched.imu[:3] - imu.accelerometer_bias_m_s2
    np.testing.assert_allclose(data.sensor("imu").data, force, atol=imu.accelerometer_resolution_m_s2)
    assert np.abs(data.qacc).max() < 1e-6


def test_actuators_take_effort_in_the_drives_unit_up_to_its_limit(exported: mujoco.MjModel) -> None:
    for drive in load_machine("carm").plant.drives:
        assert exported.actuator(drive.axis).gear[0] == pytest.approx(drive.constant * drive.ratio)
        np.testing.assert_allclose(exported.actuator(drive.axis).ctrlrange, [-drive.limit, drive.limit])


def test_nothing_collides(exported: mujoco.MjModel) -> None:
    assert exported.ngeom == 0


def test_a_point_mass_on_a_slide_is_a_model_mujoco_takes() -> None:
    model = mujoco.MjModel.from_xml_string(to_mjcf(load_machine("emps").plant, "emps"))
    assert model.body("carriage").mass[0] == pytest.approx(95.1089)
