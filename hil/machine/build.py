"""From the file's tables to the plant's, sensors' and controllers' settings, with every cross-reference checked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from controllers.settings import AxisLimits
from hil.machine.build_bodies import build_tree, orientation_matrix
from hil.machine.machine import AxisUnits, Geometry
from hil.machine.messages import ComplaintError
from hil.machine.schema import CurrentTable, DriveTable, EncoderTable, ImuTable, MachineTable, SpeedTable, TemperatureTable
from hil.machine.table import Table
from hil.machine.units import ANGULAR, CONSTANT_UNITS, LINEAR
from virtual_bus.effects.binding import bind_effects
from virtual_bus.errors import EffectError
from virtual_bus.plant.parameters import possible_parameters
from virtual_bus.settings import CurrentSensor, Drive, EffectSetting, Encoder, Imu, Joint, PlantSettings, SpeedSensor, Thermometer, Tree

Where = tuple[str | int, ...]

APART = "give each a sensor of its own, or write the one that turns by small angles as sliding, inertia and stiffness over lever squared"
ALONE = "for a sensor of joints without a drive alone give one of them a drive whose command is 0"
TOGETHER = "write motors that push one joint as one drive with the sum of their constants, and record the mean of their efforts"
"""What to do where a machine has what no table of the file says."""
POSITION_UNITS = {"revolute": "rad", "prismatic": "m"}


def require_known(name: str, known: Iterable[str], where: Where, what: str) -> None:
    """Complain unless `name` is one of `known`."""
    names = list(known)
    if name not in names:
        raise ComplaintError(where, f"no such {what}; there is " + (", ".join(names) or "none"))


def require_kind(table: Table, field: str, kind: str, where: Where) -> None:
    """Complain when a unit does not fit a revolute or a prismatic joint."""
    dimension = table.dimension(field)
    allowed = ANGULAR if kind == "revolute" else LINEAR
    if dimension is not None and dimension not in allowed:
        unit = "an angular unit" if kind == "revolute" else "a linear unit"
        raise ComplaintError((*where, table.key(field)), f"does not fit a {kind} joint; give it {unit}")


def build_plant(table: MachineTable) -> PlantSettings:
    """Everything the emulated physics needs."""
    joints = {body.joint.name: body.joint for body in table.body if body.joint is not None}
    drives = []
    armatures: dict[str, float] = {}
    for axis, drive in table.drives.items():
        require_known(drive.joint, joints, ("drives", axis, "joint"), "joint")
        if drive.joint in armatures:
            raise ComplaintError(("drives", axis, "joint"), f"already driven by another axis; one drive per joint: {TOGETHER}")
        drives.append(_drive(axis, drive, joints[drive.joint].type))
        armatures[drive.joint] = (drive.rotor_inertia or drive.rotor_mass) * drive.ratio**2
    tree = build_tree(table, armatures)
    kinds = {axis: joints[drive.joint].type for axis, drive in table.drives.items()}
    encoders, speeds, currents, imus, thermometers = [], [], [], [], []
    for channel, sensor in table.sensors.items():
        where: Where = ("sensors", channel)
        if isinstance(sensor, EncoderTable):
            encoders.append(_encoder(channel, sensor, table, tree))
        elif isinstance(sensor, SpeedTable):
            speeds.append(_speed(channel, sensor, table, tree))
        elif isinstance(sensor, CurrentTable):
            currents.append(_current(channel, sensor, table))
        elif isinstance(sensor, ImuTable):
            if channel != "imu" and not channel.startswith("imu_"):
                right = "an IMU is called imu, a further one imu_NAME: its channels are imu_NAME_x … gyro_NAME_z"
                raise ComplaintError(where, f"{right}; rename the table [sensors.imu]")
            require_known(sensor.body, [body.name for body in table.body], (*where, "body"), "body")
            imus.append(_imu(channel, sensor))
        elif isinstance(sensor, TemperatureTable):
            thermometers.append(_thermometer(channel, sensor, table))
    for axis in kinds:
        if f"position_{axis}" not in table.sensors and (table.controller or table.bus):
            raise ComplaintError(("sensors", f"position_{axis}"), "is missing; every axis with a controller has a motor-side encoder")
    watched = () if table.geometry is None else tuple(dict.fromkeys((table.geometry.source_body, table.geometry.detector_body)))
    plant = PlantSettings(
        tree=tree,
        drives=tuple(drives),
        encoders=tuple(encoders),
        currents=tuple(currents),
        imus=tuple(imus),
        thermometers=tuple(thermometers),
        sample_period_s=1.0 / table.timing.sample_rate,
        substeps=table.timing.substeps,
        watched_bodies=watched,
        speeds=tuple(speeds),
        strokes=tuple((axis, limits.range[1] - limits.range[0]) for axis, limits in table.limits.items()),
    )
    return replace(plant, tolerances=tuple(_tolerances(table, plant)), effects=_effects(table, plant))


def _effects(table: MachineTable, plant: PlantSettings) -> tuple[EffectSetting, ...]:
    """Effects that the file states, bound to its places."""
    try:
        return bind_effects(table.effect, plant, "[[effect]]")
    except EffectError as error:
        raise ComplaintError((), str(error)) from None


def _tolerances(table: MachineTable, plant: PlantSettings) -> Iterator[tuple[str, float]]:
    """Name and hard bound of every number that the file gives one."""
    known = [parameter.name for parameter in possible_parameters(plant)]
    for owner, numbers in table.tolerances.items():
        own = [name.partition(".")[2] for name in known if name.startswith(f"{owner}.")]
        if not own:
            require_known(
                owner, dict.fromkeys(name.partition(".")[0] for name in known), ("tolerances", owner), "body, joint, drive or IMU"
            )
        for quantity, bound in numbers.items():
            require_known(quantity, own, ("tolerances", owner, quantity), "number")
            yield f"{owner}.{quantity}", bound


def _drive(axis: str, drive: DriveTable, kind: str) -> Drive:
    where: Where = ("drives", axis)
    effort, per, factor = CONSTANT_UNITS[drive.constant_unit]
    if per != drive.effort_unit:
        raise ComplaintError(
            (*where, "constant_unit"), f"does not fit effort_unit {drive.effort_unit}; write Nm/{drive.effort_unit} or similar"
        )
    if kind == "revolute" and effort == "N":
        raise ComplaintError((*where, "constant_unit"), f"a force cannot drive the revolute joint {drive.joint}; write Nm/{per}")
    for field in ("limit", "rated_current", "rated_effort", "target_resolution"):
        if drive.dimension(field) not in (None, "share"):
            require_effort_unit(drive, field, drive.effort_unit, where)
    if drive.has("rotor_inertia") and drive.has("rotor_mass"):
        raise ComplaintError((*where, drive.key("rotor_mass")), "a rotor either turns or slides; keep rotor_inertia or rotor_mass")
    slides = kind == "prismatic" and effort == "N"
    if drive.has("rotor_mass" if not slides else "rotor_inertia"):
        field, right = ("rotor_inertia", "rotor_mass_kg") if slides else ("rotor_mass", "rotor_inertia_kg_m2")
        raise ComplaintError((*where, drive.key(field)), f"does not fit {drive.constant_unit}; write {right}")
    rated = drive.rated_current if drive.rated_current is not None else drive.rated_effort
    resolution = drive.target_resolution
    if drive.dimension("target_resolution") == "share":
        if rated is None:
            reason = "is a share of the rated value; add rated_current_A or rated_effort_…"
            raise ComplaintError((*where, drive.key("target_resolution")), reason)
        resolution = drive.target_resolution * rated
    return Drive(
        axis=axis,
        joint=drive.joint,
        unit=drive.effort_unit,
        constant=drive.constant * factor,
        ratio=drive.ratio,
        limit=drive.limit,
        resolution=resolution,
        rated=drive.limit if rated is None else rated,
    )


def require_effort_unit(table: Table, field: str, unit: str, where: Where) -> None:
    """Complain when an effort is not in the drive's unit (mA and the like included)."""
    written = table.unit(field)
    if written and written.lstrip("mk") != unit:
        raise ComplaintError((*where, table.key(field)), f"does not fit the drive's effort_unit; write {field}_{unit}")


def _encoder(channel: str, sensor: EncoderTable, table: MachineTable, tree: Tree) -> Encoder:
    where: Where = ("sensors", channel)
    axis = _axis_of(channel, ("position", "link_position"), "an encoder", table)
    drive = table.drives[axis]
    kind = _check_joints(sensor, drive, tree, where)
    return Encoder(channel, sensor.joints, _encoder_resolution(sensor, drive, kind, where), sensor.kind == "absolute")


def _encoder_resolution(sensor: EncoderTable, drive: DriveTable, kind: str, where: Where) -> float:
    if sensor.resolution is not None:
        require_kind(sensor, "resolution", kind, where)
        return sensor.resolution
    if sensor.counts_per_turn is not None:
        if kind != "revolute":
            raise ComplaintError((*where, "counts_per_turn"), "a prismatic joint has no turns; write resolution_um")
        return math.tau / sensor.counts_per_turn
    if drive.encoder_counts_per_motor_turn is None:
        choices = "resolution_rad, counts_per_turn" if kind == "revolute" else "resolution_um"
        raise ComplaintError(where, f"needs {choices} or the drive's encoder_counts_per_motor_turn")
    return math.tau / (drive.encoder_counts_per_motor_turn * drive.ratio)


def _check_joints(sensor: EncoderTable | SpeedTable, drive: DriveTable, tree: Tree, where: Where) -> str:
    """Complain unless the joints may be summed for this axis; what kind they are."""
    by_name = {joint.name: joint for joint in tree.joints}
    for number, joint in enumerate(sensor.joints):
        require_known(joint, by_name, (*where, "joints", number), "joint")
    kind = by_name[drive.joint].kind
    if drive.joint not in sensor.joints:
        raise ComplaintError((*where, "joints"), f"must contain the axis's joint {drive.joint}; {ALONE}")
    if any(by_name[joint].kind != kind for joint in sensor.joints):
        raise ComplaintError(
            (*where, "joints"),
            f"mixes revolute and prismatic joints, whose sum has no unit; all must be {kind} like {drive.joint}: {APART}",
        )
    return kind


def _speed(channel: str, sensor: SpeedTable, table: MachineTable, tree: Tree) -> SpeedSensor:
    where: Where = ("sensors", channel)
    if table.bus is not None:
        raise ComplaintError((*where, "type"), "no node of the bus sends it; speed sensors are for machines without [bus]")
    kind = _check_joints(sensor, table.drives[_axis_of(channel, ("speed",), "a speed sensor", table)], tree, where)
    require_kind(sensor, "resolution", kind, where)
    return SpeedSensor(channel, sensor.joints, sensor.resolution)


def _current(channel: str, sensor: CurrentTable, table: MachineTable) -> CurrentSensor:
    where: Where = ("sensors", channel)
    require_known(sensor.axis, table.drives, (*where, "axis"), "axis")
    unit = table.drives[sensor.axis].effort_unit
    expected = f"{'current' if unit == 'A' else 'effort'}_{sensor.axis}"
    if channel != expected:
        raise ComplaintError(where, f"must be called {expected}: keys are channel names")
    for field in ("resolution", "noise_rms"):
        require_effort_unit(sensor, field, unit, where)
    return CurrentSensor(channel, sensor.axis, sensor.resolution, sensor.noise_rms)


def _imu(channel: str, sensor: ImuTable) -> Imu:
    return Imu(
        name=channel,
        body=sensor.body,
        position_m=np.array(sensor.position),
        orientation=orientation_matrix(sensor.orientation),
        accelerometer_noise_rms_m_s2=np.array(sensor.accelerometer_noise_rms),
        accelerometer_bias_m_s2=np.array(sensor.accelerometer_bias),
        accelerometer_bandwidth_Hz=sensor.accelerometer_bandwidth,
        accelerometer_resolution_m_s2=sensor.accelerometer_resolution,
        gyro_noise_rms_rad_s=np.array(sensor.gyro_noise_rms),
        gyro_bias_rad_s=np.array(sensor.gyro_bias),
        gyro_bandwidth_Hz=sensor.gyro_bandwidth,
        gyro_resolution_rad_s=sensor.gyro_resolution,
    )


def _thermometer(channel: str, sensor: TemperatureTable, table: MachineTable) -> Thermometer:
    where: Where = ("sensors", channel)
    require_known(sensor.axis, table.drives, (*where, "axis"), "axis")
    if channel != f"temperature_{sensor.axis}":
        raise ComplaintError(where, f"must be called temperature_{sensor.axis}: keys are channel names")
    unit = table.drives[sensor.axis].effort_unit
    if sensor.unit("rise") != f"K_per_{unit}2":
        raise ComplaintError((*where, sensor.key("rise")), f"does not fit the drive's effort_unit; write rise_K_per_{unit}2")
    return Thermometer(channel, sensor.axis, sensor.ambient, sensor.rise, sensor.time_constant, sensor.resolution)


def _axis_of(channel: str, stems: tuple[str, ...], what: str, table: MachineTable) -> str:
    for stem in stems:
        axis = channel.removeprefix(f"{stem}_")
        if axis != channel and axis in table.drives:
            return axis
    possible = ", ".join(f"{stem}_{axis}" for axis in table.drives for stem in stems)
    raise ComplaintError(("sensors", channel), f"is no channel of {what}; call it one of {possible}")


def joint_of(axis: str, table: MachineTable, tree: Tree) -> Joint:
    """Return the actuated joint of an axis."""
    return tree.joints[tree.joint_index(table.drives[axis].joint)]


def build_units(table: MachineTable, tree: Tree) -> tuple[AxisUnits, ...]:
    """Units every axis is recorded in."""
    return tuple(
        AxisUnits(axis, POSITION_UNITS[joint_of(axis, table, tree).kind], drive.effort_unit) for axis, drive in table.drives.items()
    )


def build_limits(table: MachineTable, tree: Tree) -> tuple[AxisLimits, ...]:
    """Build the limits of every axis, in axis order; infinite where the file says nothing."""
    for axis, limits in table.limits.items():
        where: Where = ("limits", axis)
        require_known(axis, table.drives, where, "axis")
        for field in ("range", "speed", "acceleration", "jerk", "tracking_error", "quick_stop"):
            require_kind(limits, field, joint_of(axis, table, tree).kind, where)
        if not limits.range[0] < limits.range[1]:
            raise ComplaintError((*where, limits.key("range")), "the lower end must be below the upper end")
    inf = math.inf
    found = []
    for axis in table.drives:
        entry = table.limits.get(axis)
        unit = POSITION_UNITS[joint_of(axis, table, tree).kind]
        if entry is None:
            found.append(AxisLimits(axis, -inf, inf, inf, inf, inf, inf, unit))
        else:
            found.append(AxisLimits(axis, *entry.range, entry.speed, entry.acceleration, entry.jerk, entry.tracking_error, unit))
    return tuple(found)


def build_geometry(table: MachineTable) -> Geometry | None:
    """Imaging geometry, when the file has one."""
    geometry = table.geometry
    if geometry is None:
        return None
    names = [body.name for body in table.body]
    require_known(geometry.source_body, names, ("geometry", "source_body"), "body")
    require_known(geometry.detector_body, names, ("geometry", "detector_body"), "body")
    return Geometry(
        isocenter_m=np.array(geometry.isocenter),
        source_body=geometry.source_body,
        source_position_m=np.array(geometry.source_position),
        detector_body=geometry.detector_body,
        detector_center_m=np.array(geometry.detector_center),
        detector_size_m=np.array(geometry.detector_size),
        detector_pixels=geometry.detector_pixels,
    )
