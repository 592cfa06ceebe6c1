"""A machine's plant as a MuJoCo model: the second opinion on its physics, and what other simulators read."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from virtual_bus.settings import Body, Drive, Encoder, Imu, Joint, PlantSettings, SpeedSensor

JOINT_TYPES = {"revolute": "hinge", "prismatic": "slide"}

POINT_RADIUS_m = 1e-3
"""MuJoCo refuses a mass without inertia; a point mass, which the machine file allows where nothing turns, gets this radius of gyration."""


def to_mjcf(settings: PlantSettings, name: str) -> str:
    """MJCF of a plant.

    Bodies, joints and actuators (named as the axis) bear the machine file's names, sensors the names of their recording channels.
    Actuators take effort in the drive's unit. Gears, rotor inertia, springs, dampers and viscous friction are in it; noise, quantisation,
    sensor bandwidth, brakes and effects are not. There are no geometries, so nothing collides.
    """
    root = Element("mujoco", model=name)
    SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="false")
    SubElement(
        root, "option", gravity=_numbers(settings.tree.gravity_m_s2), timestep=_number(settings.sample_period_s / settings.substeps),
        integrator="implicitfast",
    )  # fmt: skip
    _add_bodies(SubElement(root, "worldbody"), settings)
    joints = {joint.name: joint for joint in settings.tree.joints}
    sums = [sensor for sensor in settings.joint_sensors if len(sensor.joints) > 1]
    if sums:
        _add_sums(SubElement(root, "tendon"), sums)
    actuators = SubElement(root, "actuator")
    for drive in settings.drives:
        _add_actuator(actuators, drive)
    sensors = SubElement(root, "sensor")
    for encoder in settings.encoders:
        if len(encoder.joints) > 1:
            SubElement(sensors, "tendonpos", name=encoder.channel, tendon=encoder.channel)
        else:
            SubElement(sensors, "jointpos", name=encoder.channel, joint=joints[encoder.joints[0]].name)
    for speed in settings.speeds:
        if len(speed.joints) > 1:
            SubElement(sensors, "tendonvel", name=speed.channel, tendon=speed.channel)
        else:
            SubElement(sensors, "jointvel", name=speed.channel, joint=joints[speed.joints[0]].name)
    for current in settings.currents:
        SubElement(sensors, "actuatorfrc", name=current.channel, actuator=current.axis)
    for imu in settings.imus:
        SubElement(sensors, "accelerometer", name=imu.name, site=imu.name)
        SubElement(sensors, "gyro", name=gyro_name(imu), site=imu.name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def gyro_name(imu: Imu) -> str:
    """`imu` has its rates in gyro_x, gyro_y, gyro_z, `imu_source` in gyro_source_x, gyro_source_y, gyro_source_z."""
    return f"gyro{imu.name.removeprefix('imu')}"


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: np.ndarray) -> str:
    return " ".join(_number(value) for value in np.ravel(values))


def _quaternion(rotation: np.ndarray) -> str:
    return _numbers(Rotation.from_matrix(rotation).as_quat(scalar_first=True))


def _add_bodies(world: Element, settings: PlantSettings) -> None:
    elements = {"world": world}
    for body in settings.tree.bodies:
        orientation = _quaternion(body.orientation)
        element = SubElement(elements[body.parent], "body", name=body.name, pos=_numbers(body.position_m), quat=orientation)
        elements[body.name] = element
        _add_inertia(element, body)
        if body.joint is not None:
            _add_joint(element, body.joint)
        for imu in settings.imus:
            if imu.body == body.name:
                SubElement(element, "site", name=imu.name, pos=_numbers(imu.position_m), quat=_quaternion(imu.orientation))


def _add_inertia(element: Element, body: Body) -> None:
    if body.mass_kg == 0.0 and not body.inertia_kg_m2.any():
        return
    inertia = body.inertia_kg_m2 if body.inertia_kg_m2.any() else body.mass_kg * POINT_RADIUS_m**2 * np.eye(3)
    SubElement(
        element, "inertial", pos=_numbers(body.center_of_mass_m), mass=_number(body.mass_kg),
        fullinertia=_numbers(np.array([*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]])),
    )  # fmt: skip


def _add_joint(element: Element, joint: Joint) -> None:
    SubElement(
        element, "joint", name=joint.name, type=JOINT_TYPES[joint.kind], axis=_numbers(joint.axis), stiffness=_number(joint.stiffness),
        damping=_number(joint.damping), springref=_number(joint.rest_position), armature=_number(joint.armature),
    )  # fmt: skip


def _add_sums(tendons: Element, sums: Sequence[Encoder | SpeedSensor]) -> None:
    for encoder in sums:
        fixed = SubElement(tendons, "fixed", name=encoder.channel)
        for joint in encoder.joints:
            SubElement(fixed, "joint", joint=joint, coef="1")


def _add_actuator(actuators: Element, drive: Drive) -> None:
    limit = _number(drive.limit)
    SubElement(
        actuators, "motor", name=drive.axis, joint=drive.joint, gear=_number(drive.constant * drive.ratio), ctrllimited="true",
        ctrlrange=f"-{limit} {limit}",
    )  # fmt: skip
