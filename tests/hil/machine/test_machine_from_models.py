"""Machine files made of MJCF and URDF: MuJoCo, which reads the model itself, sees the same masses, springs and frequencies in both."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import Isocenter

from hil.machine import Machine, load_machine
from hil.machine.mjcf import to_mjcf
from virtual_bus.physics import Physics

# bodies with two joints at different anchors, a turned frame, a skew inertia, a reference and a spring at rest elsewhere, a slide
AWKWARD = """<mujoco model="awkward">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="base" pos="0.1 0.2 0.3" euler="0.3 -0.4 0.5">
      <inertial pos="0.01 0.02 0.03" mass="4" fullinertia="0.2 0.25 0.3 0.01 0.02 0.015"/>
      <joint name="lift" type="slide" axis="0 0 1" pos="0.1 0 0" damping="3" range="-0.2 0.4" limited="true"/>
      <joint name="pan" axis="0 0 1" pos="0.05 -0.02 0" damping="0.4" stiffness="50" springref="0.1" ref="0.2"/>
      <body name="fixed" pos="0 0 0.2"><inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/></body>
      <body name="arm" pos="0.3 0 0.1">
        <inertial pos="0.2 0 0" mass="2" diaginertia="0.02 0.06 0.07"/>
        <joint name="tilt/1" axis="0 1 1" armature="0.05" damping="0.2" stiffness="200"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="lift" joint="lift" gear="40" ctrlrange="-10 10" ctrllimited="true"/>
    <motor name="tilt" joint="tilt/1" gear="20" ctrlrange="-1.5 1.5" ctrllimited="true"/>
  </actuator>
</mujoco>
"""

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial><origin xyz="0.2 0 0"/><mass value="3"/><inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0.001" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://not/there.stl"/></geometry></visual>
  </link>
  <link name="lower">
    <inertial><origin xyz="0.15 0 0"/><mass value="1.5"/><inertia ixx="0.005" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.5" rpy="0 0.2 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1.5" effort="60" velocity="2"/><dynamics damping="0.7"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="25" velocity="3"/><dynamics damping="0.3"/>
  </joint>
</robot>
"""


def made(isocenter: Isocenter, model: Path, *more: object) -> Machine:
    out = model.with_name("made.toml")
    done = isocenter("machine", "new", "--from", model, "-o", out, "--no-ask", *more)
    assert done.status == 0, done.err
    assert "OPEN" not in done.out, done.out
    return load_machine(out)


def exported(machine: Machine) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(to_mjcf(machine.plant, machine.name))


def seen(model: mujoco.MjModel, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix and bias with springs at a displacement from the model's zero, by MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + displacement
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass, data.qfrc_bias - data.qfrc_passive


def assert_same(first: mujoco.MjModel, second: mujoco.MjModel, within: float) -> None:
    assert [first.joint(k).name.replace("/", "_") for k in range(first.njnt)] == [second.joint(k).name for k in range(second.njnt)]
    for displacement in np.random.default_rng(0).uniform(-0.5, 0.5, (8, first.nv)):
        for one, other in zip(seen(first, displacement), seen(second, displacement), strict=True):
            np.testing.assert_allclose(other, one, rtol=within, atol=within * np.abs(one).max())


def frequencies(machine: Machine) -> np.ndarray:
    poles = np.linalg.eigvals(Physics(machine.plant, noise=False).linearise(np.zeros(len(machine.axes))).A)
    return np.sort(np.abs(poles[poles.imag > 1.0]))


@pytest.mark.slow
def test_export_and_back_is_the_same_plant(isocenter: Isocenter, tmp_path: Path) -> None:
    carm, model = load_machine("carm"), tmp_path / "carm.xml"
    assert isocenter("machine", "export", "carm", "--mjcf", model).status == 0
    machine = made(isocenter, model)
    assert machine.axes == carm.axes
    assert_same(mujoco.MjModel.from_xml_path(str(model)), exported(machine), 1e-9)
    np.testing.assert_allclose([drive.limit for drive in machine.plant.drives], 8.0)
    new, old = frequencies(machine), frequencies(carm)
    assert len(old) > 4
    np.testing.assert_allclose(new[-5:], old[-5:], rtol=1e-6)  # the IMU's filters have real poles


def test_an_awkward_model_keeps_its_masses_springs_and_gears(isocenter: Isocenter, tmp_path: Path) -> None:
    model = tmp_path / "awkward.xml"
    model.write_text(AWKWARD)
    machine = made(isocenter, model)
    assert machine.axes == ("lift", "tilt")
    assert_same(mujoco.MjModel.from_xml_path(str(model)), exported(machine), 1e-5)  # a millionth of a mass stands between two joints
    (lift, tilt) = machine.plant.drives
    assert (lift.constant * lift.ratio, lift.limit, tilt.constant * tilt.ratio, tilt.limit) == pytest.approx((40.0, 10.0, 20.0, 1.5))
    assert machine.plant.tree.joints[-1].armature == pytest.approx(0.05)


def test_a_urdf_needs_no_meshes_and_every_joint_gets_a_drive(isocenter: Isocenter, tmp_path: Path) -> None:
    model = tmp_path / "arm.urdf"
    model.write_text(URDF)
    machine = made(isocenter, model, "-a", "shoulder.limit=60", "-a", "elbow.limit=25")
    assert machine.axes == ("shoulder", "elbow")
    shoulder, elbow = (joint.joint for joint in machine.plant.tree.bodies if joint.joint is not None)
    assert (shoulder.damping, elbow.damping) == pytest.approx((0.7, 0.3))
    effort = Physics(machine.plant, noise=False).holding_effort(np.array([-0.2, 0.0]))  # both links level
    assert -effort[1] == pytest.approx(1.5 * 9.81 * 0.15)
    assert -effort[0] == pytest.approx(3.0 * 9.81 * 0.2 + 1.5 * 9.81 * 0.55)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>", "is a free or ball joint"),
        ("<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>", "no body of it has a joint"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "MuJoCo refuses it: "),
        ("<sdf/>", "is <sdf>; a model is <mujoco> (MJCF) or <robot> (URDF)"),
        ("mass = 3", "is no XML"),
        (AWKWARD.replace('gear="40"', 'gear="-40"'), "actuator lift has a gear of -40"),
    ],
)  # fmt: skip
def test_a_model_that_is_no_machine_is_refused_in_one_line(isocenter: Isocenter, tmp_path: Path, text: str, says: str) -> None:
    model = tmp_path / "model.xml"
    model.write_text(text)
    refused = isocenter("machine", "new", "--from", model, "-o", tmp_path / "x.toml", "--no-ask")
    assert refused.status == 2
    assert says in refused.line
