"""Check that settings describe a plant that can be simulated, with errors that name the entry at fault."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from virtual_bus.errors import PlantError
from virtual_bus.settings import Body, Joint, PlantSettings, Tree

TRIANGLE_SLACK = 1e-9  # principal inertias of a real body obey A + B >= C; a thin rod meets it with equality


def check_plant(settings: PlantSettings) -> None:
    """Raise PlantError unless the equations of motion of this plant exist and its sensors sit on it.

    Raises
    ------
    PlantError
        A parent listed after its child or nowhere, names used twice, a joint axis that is no unit vector, negative mass, an inertia no
        rigid body has, a moving joint without inertia behind it, a drive or sensor on a joint or body that does not exist.
    """
    _check_tree(settings.tree)
    bodies = {body.name for body in settings.tree.bodies}
    joints = {joint.name for joint in settings.tree.joints}
    for drive in settings.drives:
        if drive.joint not in joints:
            raise PlantError(f"drives.{drive.axis}.joint = {drive.joint!r}: no such joint; the tree has {', '.join(sorted(joints))}")
    for encoder in settings.joint_sensors:
        for joint in encoder.joints:
            if joint not in joints:
                raise PlantError(f"sensors.{encoder.channel}.joints: no joint {joint!r}; the tree has {', '.join(sorted(joints))}")
    axes = {drive.axis for drive in settings.drives}
    for channel, axis in [(s.channel, s.axis) for s in settings.currents] + [(s.channel, s.axis) for s in settings.thermometers]:
        if axis not in axes:
            raise PlantError(f"sensors.{channel}.axis = {axis!r}: no such axis; the machine has {', '.join(sorted(axes))}")
    for where, name in [(f"sensors.{imu.name}.body", imu.body) for imu in settings.imus] + [
        ("watched body", name) for name in settings.watched_bodies
    ]:
        if name not in bodies:
            raise PlantError(f"{where} = {name!r}: no such body; the tree has {', '.join(sorted(bodies))}")
    if settings.sample_period_s <= 0.0 or settings.substeps < 1:
        raise PlantError(f"timing: sample period {settings.sample_period_s} s in {settings.substeps} substeps; both must be positive")


def _check_tree(tree: Tree) -> None:
    seen: set[str] = {"world"}
    for body in tree.bodies:
        if body.name in seen:
            raise PlantError(f"body {body.name!r}: the name is used twice, or is 'world'")
        if body.parent not in seen:
            raise PlantError(f"body {body.name!r}: parent {body.parent!r} is not listed before it; a tree has no loops")
        seen.add(body.name)
        _check_body(body)
    names = [joint.name for joint in tree.joints]
    if not names:
        raise PlantError("the plant has no joint: nothing can move")
    for name in names:
        if names.count(name) > 1:
            raise PlantError(f"joint {name!r}: the name is used twice")
    for joint, mass, inertia in _carried(tree):
        if joint.armature <= 0.0 and (inertia if joint.kind == "revolute" else mass) <= 0.0:
            raise PlantError(f"joint {joint.name!r}: nothing behind it has inertia; a body needs mass_kg and inertia_kg_m2")


def _check_body(body: Body) -> None:
    joint = body.joint
    if joint is not None:
        if joint.kind not in ("revolute", "prismatic"):
            raise PlantError(f"joint {joint.name!r}: kind {joint.kind!r}; must be revolute or prismatic")
        if abs(float(np.linalg.norm(joint.axis)) - 1.0) > 1e-9:
            raise PlantError(f"joint {joint.name!r}: axis {list(joint.axis)} is no unit vector")
        for quantity in ("stiffness", "damping", "armature", "brake_effort"):
            if not getattr(joint, quantity) >= 0.0:
                raise PlantError(f"joint {joint.name!r}: {quantity} = {getattr(joint, quantity)}; must not be negative")
    if not body.mass_kg >= 0.0:
        raise PlantError(f"body {body.name!r}: mass_kg = {body.mass_kg}; must not be negative")
    a, b, c = np.linalg.eigvalsh(body.inertia_kg_m2)
    slack = TRIANGLE_SLACK * max(c, 0.0)
    if not np.allclose(body.inertia_kg_m2, body.inertia_kg_m2.T) or a < -slack or a + b < c - slack:
        raise PlantError(
            f"body {body.name!r}: inertia_kg_m2 has principal values {a:.6g}, {b:.6g}, {c:.6g}; a rigid body has none negative and the "
            "two smaller ones sum to at least the largest"
        )


def _carried(tree: Tree) -> Iterator[tuple[Joint, float, float]]:
    """Yield each joint with the mass and a measure of the rotational inertia that it carries, its own body included."""
    carried = {body.name: [body.mass_kg, _spin_inertia(body)] for body in tree.bodies}
    for body in reversed(tree.bodies):
        if body.parent != "world":
            carried[body.parent][0] += carried[body.name][0]
            carried[body.parent][1] += carried[body.name][1] + (body.mass_kg > 0.0)
    for body in tree.bodies:
        if body.joint is not None:
            mass, inertia = carried[body.name]
            yield body.joint, mass, inertia


def _spin_inertia(body: Body) -> float:
    """Return the inertia of the body alone about its own joint's axis, or about its largest axis when it is welded."""
    about_origin = body.inertia_kg_m2 + body.mass_kg * (
        float(body.center_of_mass_m @ body.center_of_mass_m) * np.eye(3) - np.outer(body.center_of_mass_m, body.center_of_mass_m)
    )
    if body.joint is None:
        return float(np.linalg.eigvalsh(about_origin)[-1])
    return float(body.joint.axis @ about_origin @ body.joint.axis)
