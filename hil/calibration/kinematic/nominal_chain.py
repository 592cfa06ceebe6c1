"""The kinematic model according to the machine file: Denavit-Hartenberg rows by common normals, elastic joints, gravity at the bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.models.denavit_hartenberg import DenavitHartenberg
from controllers.models.flexible_chain import AT_PANEL, AT_TUBE, IN_CHAIN, ElasticJoint, FlexibleChain
from controllers.models.gravity import GravityTree
from controllers.models.motions import frames_of
from hil.errors import UnusableInputError
from hil.imaging.nominal import body_frame, imaging_geometry, nominal_beam
from hil.machine import Machine
from virtual_bus.settings import Body

PANEL, PHANTOM = "panel", "phantom"
"""Names of the chain's first and last row, which nobody drives: the panel's normal, and the phantom's z axis."""

ALIKE = 1e-6
"""Directions whose sine is below this are parallel."""


@dataclass(frozen=True)
class _Line:
    direction: np.ndarray
    point: np.ndarray


def nominal_chain(machine: Machine) -> FlexibleChain:
    """Return the chain from the panel over every driven axis to the phantom, whose frame is the world's in the isocentre.

    An elastic joint behind a drive is left out where a link encoder sums both: what was measured holds it already.

    Raises
    ------
    UnusableInputError
        No [geometry], a sliding axis on the way to the panel, or an axis that moves tube and panel apart.
    """
    geometry = imaging_geometry(machine)
    bodies = {body.name: body for body in machine.plant.tree.bodies}
    panel_path, tube_path = _path(bodies, geometry.detector_body), _path(bodies, geometry.source_body)
    driven = {drive.joint: k for k, drive in enumerate(machine.plant.drives)}
    for body in panel_path + tube_path:
        if body.joint is None or body.joint.name not in driven:
            continue
        axis = machine.axes[driven[body.joint.name]]
        if body.joint.kind != "revolute":
            raise UnusableInputError(f"{machine.name}: {axis} slides; the kinematic model knows turning axes")
        if body not in panel_path or body not in tube_path:
            raise UnusableInputError(f"{machine.name}: {axis} moves tube and panel apart; the kinematic model holds them together")
    on_the_way = [(body.name, body.joint) for body in panel_path if body.joint is not None and body.joint.name in driven]
    zero = np.zeros((1, len(machine.axes)))
    frame = {name: _pose(machine, name, zero) for name in bodies}
    panel = frame[geometry.detector_body]
    center = panel[:3, :3] @ geometry.detector_center_m + panel[:3, 3]
    lines = [_Line(panel[:3, 2], center)]
    for name, joint in on_the_way:
        lines.append(_Line(-frame[name][:3, :3] @ joint.axis, frame[name][:3, 3]))
    lines.append(_Line(np.array([0.0, 0.0, 1.0]), geometry.isocenter_m))
    names = (PANEL, *(machine.axes[driven[joint.name]] for _, joint in on_the_way), PHANTOM)
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = panel[:3, :3], center
    end = np.eye(4)
    end[:3, 3] = geometry.isocenter_m
    chain = DenavitHartenberg(names, _rows(lines, start, end), np.zeros(4))
    elastic = _elastic(machine, panel_path, tube_path, chain, start, frame)
    stiffness = {joint.name: joint.stiffness for joint in machine.plant.tree.joints}
    return FlexibleChain(
        chain=chain,
        driven=tuple(names.index(axis) if axis in names else -1 for axis in machine.axes),
        source_m=nominal_beam(machine, zero).source_m[0],
        elastic=elastic,
        compliance=np.array([1.0 / stiffness[joint.name] for joint in elastic]),
        tree=_tree(machine, elastic),
    )


def _path(bodies: dict[str, Body], name: str) -> list[Body]:
    """Return the bodies from one to the world."""
    path = []
    while name != "world":
        path.append(bodies[name])
        name = bodies[name].parent
    return path


def _pose(machine: Machine, body: str, positions: np.ndarray) -> np.ndarray:
    result = np.eye(4)
    origin, rotation = body_frame(machine, body, positions)
    result[:3, 3], result[:3, :3] = origin[0], rotation[0]
    return result


def _rows(lines: list[_Line], start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return Denavit-Hartenberg rows (n, 5) from frame `start` on the first line over the others to frame `end` on the last."""
    table = np.zeros((len(lines), 5))
    table[:, 4] = 1.0
    x, origin = start[:3, 0], start[:3, 3]
    for k, (here, there) in enumerate(zip(lines, [*lines[1:], _Line(end[:3, 2], end[:3, 3])], strict=True)):
        z = here.direction
        foot, normal, arm = _common_normal(here, there, origin, x)
        if k == len(lines) - 1:  # the last row turns about its own line into the phantom's frame
            foot, normal, arm = end[:3, 3], end[:3, 0], 0.0
        table[k, 0] = arm
        table[k, 1] = np.arctan2(np.cross(x, normal) @ z, x @ normal)
        table[k, 2] = np.arctan2(np.cross(z, there.direction) @ normal, z @ there.direction)
        table[k, 3] = (foot - origin) @ z
        x, origin = normal, foot + arm * normal
    return table


def _common_normal(here: _Line, there: _Line, origin: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the foot on `here`, the direction towards `there`, and the distance; parallel lines: through the present origin."""
    normal = np.cross(here.direction, there.direction)
    apart = there.point - here.point
    if np.linalg.norm(normal) < ALIKE:
        across = there.point - origin - here.direction * ((there.point - origin) @ here.direction)
        distance = float(np.linalg.norm(across))
        return origin, across / distance if distance > ALIKE else x, distance if distance > ALIKE else 0.0
    normal = normal / np.linalg.norm(normal)
    # apart = t here + distance normal - s there
    t, distance, _ = np.linalg.solve(np.column_stack([here.direction, normal, -there.direction]), apart)
    return here.point + t * here.direction, normal, float(distance)


def _elastic(
    machine: Machine,
    panel_path: list[Body],
    tube_path: list[Body],
    chain: DenavitHartenberg,
    start: np.ndarray,
    frame: dict[str, np.ndarray],
) -> tuple[ElasticJoint, ...]:
    driven = {drive.joint for drive in machine.plant.drives}
    measured = {joint for sensor in machine.plant.encoders if len(sensor.joints) > 1 for joint in sensor.joints}
    rows = chain.motions(np.zeros((1, len(chain.joints))))
    before = [start @ frames_of([motion for row in rows[:k] for motion in row], 1)[-1][0] for k in range(len(rows))]
    found: list[ElasticJoint] = []

    def add(body: Body, place: str, row: int) -> None:
        joint = body.joint
        assert joint is not None
        into = np.linalg.inv(before[row])
        there = frame[body.name]
        axis = into[:3, :3] @ there[:3, :3] @ joint.axis
        point = into[:3, :3] @ there[:3, 3] + into[:3, 3]
        coordinate = len(machine.axes) + len(found)
        found.append(ElasticJoint(joint.name, place, row, axis, point, joint.kind == "revolute", coordinate))

    shared = {body.name for body in tube_path}
    row = 0
    for body in panel_path:
        if body.joint is None or body.joint.name in measured - driven:
            continue
        if body.joint.name in driven:
            row = row + 1 if row else 3  # behind the row of this axis: the panel's turns, the panel's row, the first axis's
        elif body.joint.stiffness > 0.0:
            add(body, IN_CHAIN if body.name in shared else AT_PANEL, row)
    above = {body.name for body in panel_path}
    for body in tube_path:
        if body.name not in above and body.joint is not None and body.joint.stiffness > 0.0:
            add(body, AT_TUBE, 0)
    return tuple(found)


def _tree(machine: Machine, elastic: tuple[ElasticJoint, ...]) -> GravityTree:
    bodies = machine.plant.tree.bodies
    number = {body.name: k for k, body in enumerate(bodies)}
    coordinate = {drive.joint: k for k, drive in enumerate(machine.plant.drives)} | {joint.name: joint.coordinate for joint in elastic}
    return GravityTree(
        parent=np.array([number.get(body.parent, -1) for body in bodies]),
        position_m=np.array([body.position_m for body in bodies]),
        orientation=np.array([body.orientation for body in bodies]),
        axis=np.array([np.zeros(3) if body.joint is None else body.joint.axis for body in bodies]),
        revolute=np.array([body.joint is None or body.joint.kind == "revolute" for body in bodies]),
        coordinate=np.array([-1 if body.joint is None else coordinate.get(body.joint.name, -1) for body in bodies]),
        mass_kg=np.array([body.mass_kg for body in bodies]),
        center_of_mass_m=np.array([body.center_of_mass_m for body in bodies]),
        gravity_m_s2=np.array(machine.plant.tree.gravity_m_s2),
    )
