"""The tree of bodies from the file's [[body]] tables, with the checks that make it a plant."""

from __future__ import annotations

import numpy as np

from hil.machine.messages import ComplaintError
from hil.machine.schema import BodyTable, JointTable, MachineTable
from hil.machine.units import ANGULAR, LINEAR
from virtual_bus.settings import Body, Joint, Tree

_UNIT_AXIS_TOLERANCE = 1e-6  # an axis written with six digits still counts as of unit length
_TRIANGLE_TOLERANCE = 1e-9
_UNITS = {
    "revolute": {"stiffness": "Nm_rad", "damping": "Nm_s_rad", "rest_position": "deg", "brake_effort": "Nm"},
    "prismatic": {"stiffness": "N_m", "damping": "N_s_m", "rest_position": "mm", "brake_effort": "N"},
}


def build_tree(table: MachineTable, armatures: dict[str, float]) -> Tree:
    """Bodies in file order. `armatures` are the rotors' inertias at the joints they drive (kg m^2 or kg)."""
    bodies: list[Body] = []
    rotates = {"world": False}
    moves = {"world": False}
    joint_names: set[str] = set()
    for number, body in enumerate(table.body):
        where: tuple[str | int, ...] = ("body", number)
        if body.name in rotates:
            raise ComplaintError((*where, "name"), "world is the ground's name" if body.name == "world" else "two bodies have this name")
        if body.parent not in rotates:
            below = body.parent in [other.name for other in table.body[number:]]
            reason = "is listed below its child; move it up" if below else "no such body; bodies above: " + ", ".join(rotates)
            raise ComplaintError((*where, "parent"), reason)
        if body.joint is not None and body.joint.name in joint_names:
            raise ComplaintError((*where, "joint", "name"), "two joints have this name")
        rotates[body.name] = rotates[body.parent] or (body.joint is not None and body.joint.type == "revolute")
        moves[body.name] = moves[body.parent] or body.joint is not None
        inertia = _inertia(body, where, rotates[body.name], moves[body.name])
        joint = None
        if body.joint is not None:
            joint_names.add(body.joint.name)
            joint = _joint(body.joint, (*where, "joint"), armatures.get(body.joint.name, 0.0))
        bodies.append(
            Body(
                name=body.name,
                parent=body.parent,
                position_m=np.array(body.position),
                orientation=orientation_matrix(body.orientation),
                mass_kg=body.mass,
                center_of_mass_m=np.array(body.center_of_mass),
                inertia_kg_m2=inertia,
                joint=joint,
            )
        )
    if not joint_names:
        raise ComplaintError(("body",), "no body has a joint; a machine needs at least one that moves")
    return Tree(tuple(bodies), np.array(table.gravity))


def orientation_matrix(angles_rad: tuple[float, float, float]) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a frame turned about its parent's x, y and z axes, in this order."""
    if not any(angles_rad):
        return np.eye(3)  # as SciPy gives it, which takes longer to import than most machine files to read
    from scipy.spatial.transform import Rotation

    turned: np.ndarray = Rotation.from_euler("xyz", angles_rad).as_matrix()
    return turned


def _joint(joint: JointTable, where: tuple[str | int, ...], armature: float) -> Joint:
    length = float(np.linalg.norm(joint.axis))
    if abs(length - 1.0) > _UNIT_AXIS_TOLERANCE:
        right = ""
        if 0.0 < length < np.inf:
            right = f"; of unit length it is [{', '.join(f'{x / length:.9g}' for x in joint.axis)}]"
        raise ComplaintError((*where, "axis"), f"has length {length:.6g}, must have 1{right}")
    allowed = ANGULAR if joint.type == "revolute" else LINEAR
    for field in ("stiffness", "damping", "rest_position", "brake_effort"):
        dimension = joint.dimension(field)
        if dimension is not None and dimension not in allowed:
            unit = _UNITS[joint.type][field]
            raise ComplaintError((*where, joint.key(field)), f"does not fit a {joint.type} joint; write {field}_{unit}")
    return Joint(
        name=joint.name,
        kind=joint.type,
        axis=np.array(joint.axis) / length,
        stiffness=joint.stiffness,
        damping=joint.damping,
        rest_position=joint.rest_position,
        armature=armature,
        brake_effort=joint.brake_effort,
    )


def _inertia(body: BodyTable, where: tuple[str | int, ...], rotates: bool, moves: bool) -> np.ndarray:
    """(3, 3) about the centre of mass, checked to be that of a rigid body."""
    xx, yy, zz, xy, xz, yz = body.inertia
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    key = (*where, body.key("inertia"))
    if body.joint is not None and body.mass == 0.0:
        raise ComplaintError((*where, body.key("mass")), "a body on a joint needs a mass")
    if moves and rotates and body.mass > 0.0 and not body.has("inertia"):
        raise ComplaintError(key, "is missing; a body that turns needs an inertia")
    if not body.has("inertia"):
        return inertia
    if not np.all(np.isfinite(inertia)) or np.abs(inertia).max() > 1e12:
        raise ComplaintError(key, "is out of range; no body of a machine has more than 1e12 kg m^2")
    principal = np.linalg.eigvalsh(inertia)
    if principal[0] < 0.0 or (rotates and body.mass > 0.0 and principal[0] <= 0.0):
        raise ComplaintError(key, f"is not positive definite: its smallest principal moment is {principal[0]:.4g} kg m^2")
    if principal[0] + principal[1] < principal[2] * (1.0 - _TRIANGLE_TOLERANCE):
        moments = f"{principal[0]:.4g} + {principal[1]:.4g} < {principal[2]:.4g}"
        raise ComplaintError(key, f"no rigid body has these principal moments: {moments} (triangle inequality)")
    return inertia
