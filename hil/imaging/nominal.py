"""The geometry according to the machine file: no sag, no windup, every flexible joint at rest."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hil.errors import UnusableInputError
from hil.imaging.detector import Detector
from hil.imaging.geometry import ConeBeam
from hil.machine import Geometry, Machine


def imaging_geometry(machine: Machine) -> Geometry:
    """Return the machine file's [geometry].

    Raises
    ------
    UnusableInputError
        There is none.
    """
    if machine.geometry is None:
        raise UnusableInputError(f"{machine.name}: its file has no [geometry]; imaging needs to know where source and detector are")
    return machine.geometry


def nominal_detector(machine: Machine, binning: int = 1) -> Detector:
    """Return the panel of the machine file, read with `binning` x `binning` pixels as one.

    Raises
    ------
    UnusableInputError
        No [geometry], or a binning that does not divide the panel.
    """
    geometry = imaging_geometry(machine)
    columns, rows = geometry.detector_pixels
    pitch, other = geometry.detector_size_m / np.array(geometry.detector_pixels)
    try:
        return Detector(columns, rows, float(pitch), float(other / pitch)).binned(binning)
    except ValueError as error:
        raise UnusableInputError(f"{machine.name}: {error}") from None


def nominal_beam(machine: Machine, positions: np.ndarray) -> ConeBeam:
    """Return the geometry of exposures at axis positions (N, axes) [rad or m].

    It is referred to the isocentre in the world's orientation.
    """
    geometry = imaging_geometry(machine)
    positions = np.atleast_2d(np.asarray(positions, dtype=float))
    source_origin, source_rotation = body_frame(machine, geometry.source_body, positions)
    panel_origin, panel_rotation = body_frame(machine, geometry.detector_body, positions)
    source = source_origin + source_rotation @ geometry.source_position_m
    panel = panel_origin + panel_rotation @ geometry.detector_center_m
    return ConeBeam.from_frames(source - geometry.isocenter_m, panel - geometry.isocenter_m, panel_rotation)


def panel_in_tube(machine: Machine) -> np.ndarray:
    """Return the panel's axes in the tube's frame (3, 3) with every axis at zero.

    A plate on the tube is turned by this to face the panel.
    """
    geometry = imaging_geometry(machine)
    zero = np.zeros((1, len(machine.axes)))
    _, tube = body_frame(machine, geometry.source_body, zero)
    _, panel = body_frame(machine, geometry.detector_body, zero)
    relative: np.ndarray = tube[0].T @ panel[0]
    return relative


def body_frame(machine: Machine, body: str, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origin (N, 3) and rotation (N, 3, 3) of a body's frame in the world."""
    bodies = {each.name: each for each in machine.plant.tree.bodies}
    driven = {drive.joint: k for k, drive in enumerate(machine.plant.drives)}
    path = []
    while body != "world":
        path.append(bodies[body])
        body = bodies[body].parent
    origin = np.zeros((len(positions), 3))
    rotation = np.broadcast_to(np.eye(3), (len(positions), 3, 3))
    for each in reversed(path):
        origin = origin + rotation @ each.position_m
        rotation = rotation @ each.orientation
        if each.joint is None:
            continue
        moved = positions[:, driven[each.joint.name]] if each.joint.name in driven else np.zeros(len(positions))
        if each.joint.kind == "revolute":
            rotation = rotation @ Rotation.from_rotvec(moved[:, None] * each.joint.axis).as_matrix()
        else:
            origin = origin + (rotation @ each.joint.axis) * moved[:, None]
    return origin, rotation
