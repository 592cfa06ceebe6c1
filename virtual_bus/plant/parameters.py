"""The numbers of a plant that may change without a new compilation: names, units and values.

Entries that are zero in the settings are structural zeros of the equations and no parameters, unless a tolerance is stated for them.
Joint stiffness, damping, rest position,
armature and brake effort, and the sensors' bandwidths, are always parameters.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from virtual_bus.settings import Body, Drive, Imu, Joint, PlantSettings

AXES = "xyz"
INERTIA_ENTRIES = (("xx", 0, 0), ("yy", 1, 1), ("zz", 2, 2), ("xy", 0, 1), ("xz", 0, 2), ("yz", 1, 2))


@dataclass(frozen=True)
class PlantParameter:
    """One number of a plant: `c_arc.mass_kg`, `mount_sway.stiffness_Nm_rad`, `roll.armature_kg_m2`, `gravity.z_m_s2`."""

    owner: str  # body, joint, axis or sensor
    quantity: str
    unit: str
    value: float
    tolerance: float | None = None  # by how much it may be wrong at most, in its unit, as far as the machine file says

    @property
    def name(self) -> str:
        """Owner, quantity and unit in one word."""
        suffix = self.unit.replace("/", "_").replace(" ", "_").replace("^", "")
        return f"{self.owner}.{self.quantity}_{suffix}" if suffix else f"{self.owner}.{self.quantity}"


def _entries(owner: str, quantity: str, unit: str, vector: np.ndarray) -> Iterator[PlantParameter]:
    for letter, value in zip(AXES, vector, strict=True):
        yield PlantParameter(owner, f"{quantity}_{letter}", unit, float(value))


def _body_parameters(body: Body) -> Iterator[PlantParameter]:
    yield from _entries(body.name, "position", "m", body.position_m)
    if body.mass_kg != 0.0:
        yield PlantParameter(body.name, "mass", "kg", body.mass_kg)
        yield from _entries(body.name, "center_of_mass", "m", body.center_of_mass_m)
    for label, i, j in INERTIA_ENTRIES:
        yield PlantParameter(body.name, f"inertia_{label}", "kg m^2", float(body.inertia_kg_m2[i, j]))


def _joint_parameters(joint: Joint) -> Iterator[PlantParameter]:
    effort, position, inertia = ("Nm", "rad", "kg m^2") if joint.kind == "revolute" else ("N", "m", "kg")
    yield PlantParameter(joint.name, "stiffness", f"{effort}/{position}", joint.stiffness)
    yield PlantParameter(joint.name, "damping", f"{effort} s/{position}", joint.damping)
    yield PlantParameter(joint.name, "rest_position", position, joint.rest_position)
    yield PlantParameter(joint.name, "armature", inertia, joint.armature)
    yield PlantParameter(joint.name, "brake_effort", effort, joint.brake_effort)


def _drive_parameters(drive: Drive, joint: Joint) -> Iterator[PlantParameter]:
    effort = "Nm" if joint.kind == "revolute" else "N"
    yield PlantParameter(drive.axis, "constant", f"{effort}/{drive.unit}", drive.constant)
    yield PlantParameter(drive.axis, "ratio", "", drive.ratio)


def _imu_parameters(imu: Imu) -> Iterator[PlantParameter]:
    yield from _entries(imu.name, "position", "m", imu.position_m)
    yield PlantParameter(imu.name, "accelerometer_bandwidth", "Hz", imu.accelerometer_bandwidth_Hz)
    yield PlantParameter(imu.name, "gyro_bandwidth", "Hz", imu.gyro_bandwidth_Hz)


STRUCTURAL = ("position", "center_of_mass", "inertia")
"""Quantities of bodies and sensors whose zeros are left out of the equations."""


def plant_parameters(settings: PlantSettings) -> tuple[PlantParameter, ...]:
    """Return every run-time number of a plant, in the order of its parameter vector."""
    tolerances = dict(settings.tolerances)
    found = possible_parameters(settings)
    if tolerances:
        found = tuple(replace(parameter, tolerance=tolerances.get(parameter.name)) for parameter in found)
    return tuple(p for p in found if p.value != 0.0 or p.tolerance is not None or not _is_structural(p))


def _is_structural(parameter: PlantParameter) -> bool:
    return parameter.owner == "gravity" or parameter.quantity.startswith(STRUCTURAL)


def possible_parameters(settings: PlantSettings) -> tuple[PlantParameter, ...]:
    """Return every number that a plant may have, zeros of its bodies included."""
    tree = settings.tree
    found = [PlantParameter("gravity", letter, "m/s^2", float(value)) for letter, value in zip(AXES, tree.gravity_m_s2, strict=True)]
    for body in tree.bodies:
        found.extend(_body_parameters(body))
    for joint in tree.joints:
        found.extend(_joint_parameters(joint))
    for drive in settings.drives:
        found.extend(_drive_parameters(drive, tree.joints[tree.joint_index(drive.joint)]))
    for imu in settings.imus:
        found.extend(_imu_parameters(imu))
    return tuple(found)
