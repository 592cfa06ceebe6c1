"""Geometry that the observer takes from a machine file: axes, detector, source and IMUs. No masses, springs or dampers."""

from __future__ import annotations

import numpy as np

from controllers.models.chain import Chain
from controllers.models.modal import InertialSensor
from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.recording.channels import imu_channels
from virtual_bus.settings import Body


def observed_chain(machine: Machine) -> tuple[Chain, tuple[InertialSensor, ...], np.ndarray, np.ndarray]:
    """Return the chain of the driven axes to the detector, its IMUs, the focal spot and the isocentre.

    The detector's frame at position zero serves as the world's, so that all estimates are in the detector's own frame.

    Returns
    -------
    chain, sensors
    source_end : (3,) array
        Focal spot from the last axis's point [m].
    isocenter : (3,) array
        In the detector's frame at position zero, from the world's origin [m].

    Raises
    ------
    UnusableInputError
        No [geometry], no IMU on the detector, or axes that do not lead to the detector in the machine's order.
    """
    geometry = machine.geometry
    if geometry is None:
        raise UnusableInputError(f"{machine.name}: its file has no [geometry]; an observer needs to know where source and detector are")
    tree = machine.plant.tree
    bodies = {body.name: body for body in tree.bodies}
    placed = placed_bodies(tree.bodies)
    path = _path(bodies, geometry.detector_body)
    driven = {drive.joint: drive.axis for drive in machine.plant.drives}
    joints = [(body, body.joint) for body in path if body.joint is not None and body.joint.name in driven]
    if tuple(driven[joint.name] for _, joint in joints) != machine.axes:
        raise UnusableInputError(
            f"{machine.name}: the way from the world to {geometry.detector_body} passes the axes {[driven[j.name] for _, j in joints]};"
            f" an observer needs all of {list(machine.axes)}, in this order"
        )
    to_detector = placed[geometry.detector_body][1].T
    points = [to_detector @ placed[body.name][0] for body, _ in joints]
    last = points[-1]
    chain = Chain(
        axes=np.array([to_detector @ placed[body.name][1] @ joint.axis for body, joint in joints]),
        points=np.array([point - before for point, before in zip(points, [np.zeros(3), *points[:-1]], strict=True)]),
        revolute=np.array([joint.kind == "revolute" for _, joint in joints]),
        gravity_m_s2=to_detector @ tree.gravity_m_s2,
    )

    def end(body: str, position: np.ndarray) -> np.ndarray:
        origin, rotation = placed[body]
        moved: np.ndarray = to_detector @ (origin + rotation @ position) - last
        return moved

    centers = {geometry.detector_body: geometry.detector_center_m, geometry.source_body: geometry.source_position_m}
    sensors = []
    for imu in sorted(machine.plant.imus, key=lambda imu: imu.body != geometry.detector_body):
        if joints[-1][0] not in _path(bodies, imu.body):
            continue
        bandwidth = imu.accelerometer_bandwidth_Hz
        sensors.append(
            InertialSensor(
                body_end_m=end(imu.body, centers.get(imu.body, np.zeros(3))),
                sensor_end_m=end(imu.body, imu.position_m),
                rotation=to_detector @ placed[imu.body][1] @ imu.orientation,
                lag_s=1.0 / (2.0 * np.pi * bandwidth) if bandwidth > 0.0 else 0.0,
                channels=imu_channels(imu.name),
            )
        )
    if not sensors or machine.plant.imus[0].body != geometry.detector_body:
        raise UnusableInputError(
            f"{machine.name}: no IMU on {geometry.detector_body}; without one an observer sees no more than the encoders"
        )
    return chain, tuple(sensors), end(geometry.source_body, geometry.source_position_m), to_detector @ geometry.isocenter_m


def placed_bodies(bodies: tuple[Body, ...]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return position and rotation of every body in the world, all joints at zero."""
    placed = {"world": (np.zeros(3), np.eye(3))}
    for body in bodies:
        origin, rotation = placed[body.parent]
        placed[body.name] = (origin + rotation @ body.position_m, rotation @ body.orientation)
    return placed


def _path(bodies: dict[str, Body], name: str) -> list[Body]:
    """Return the bodies from the world to this one."""
    path = []
    while name != "world":
        path.append(bodies[name])
        name = bodies[name].parent
    return path[::-1]
