"""Places on a machine where effects may act: axes, bodies, the springs behind them, sensors and their channels."""

from __future__ import annotations

from virtual_bus.effects.effect import EffectKind
from virtual_bus.settings import Body, PlantSettings

IMU_LETTERS = "xyz"


def imu_channel_names(settings: PlantSettings) -> list[str]:
    """Return the channel names of all IMUs in the order of their readings.

    They are imu_x ... gyro_z of `imu`, imu_source_x ... gyro_source_z of `imu_source`.
    """
    names = []
    for imu in settings.imus:
        gyro = f"gyro{imu.name.removeprefix('imu')}"
        names += [f"{imu.name}_{letter}" for letter in IMU_LETTERS] + [f"{gyro}_{letter}" for letter in IMU_LETTERS]
    return names


def joint_at(at: str, settings: PlantSettings) -> str:
    """Return the name of the joint that an axis drives, or that carries a body."""
    for drive in settings.drives:
        if drive.axis == at:
            return drive.joint
    joint = _body(at, settings).joint
    assert joint is not None, at
    return joint.name


def spring_at(at: str, settings: PlantSettings) -> str | None:
    """Return the name of the sprung joint directly behind an axis's joint, or that carries a body.

    None where there is no such joint.
    """
    driven = {drive.joint for drive in settings.drives}
    if not any(drive.axis == at for drive in settings.drives):
        joint = _body(at, settings).joint
        return joint.name if joint is not None and joint.stiffness > 0.0 else None
    bodies = {body.name: body for body in settings.tree.bodies}
    for body in settings.tree.bodies:
        if body.joint is None or body.joint.stiffness <= 0.0 or body.joint.name in driven:
            continue
        carrier = bodies.get(body.parent)
        while carrier is not None and carrier.joint is None:
            carrier = bodies.get(carrier.parent)
        if carrier is not None and carrier.joint is not None and carrier.joint.name == joint_at(at, settings):
            return body.joint.name
    return None


def undriven_joint_at(at: str, settings: PlantSettings) -> str | None:
    """Return the name of the joint that carries a body and has no drive.

    Such a joint moves as far as its spring gives way. None at any other place.
    """
    if not any(body.name == at and body.joint is not None for body in settings.tree.bodies):
        return None
    name = joint_at(at, settings)
    return None if name in {drive.joint for drive in settings.drives} else name


def part_at(at: str, settings: PlantSettings) -> str:
    """Return the name of the part of the machine that a place belongs to.

    A part is an axis with its drive, its sensors and everything it carries up to the next drive, IMUs included, and has the axis's name.
    What no drive carries is a part with the name of its first body.
    """
    axes = {drive.joint: drive.axis for drive in settings.drives}
    axis = {current.channel: current.axis for current in settings.currents}.get(at, at)
    if axis in axes.values():
        return axis
    bodies = {body.name: body for body in settings.tree.bodies}
    name = _body_of_a_sensor(at, settings) or at
    while bodies[name].parent in bodies and _joint_name(bodies[name]) not in axes:
        name = bodies[name].parent
    return axes.get(_joint_name(bodies[name]), name)


def next_axis(at: str, settings: PlantSettings) -> str:
    """Return the axis after this one in the machine's order; the first one after the last."""
    axes = [drive.axis for drive in settings.drives]
    return axes[(axes.index(at) + 1) % len(axes)]


def joint_of_place(kind: EffectKind, at: str, settings: PlantSettings) -> str | None:
    """Return the name of the joint that effects of a kind act at, or whose motion the sensor there reads; None for other sensors."""
    if kind.needs == "spring":
        return spring_at(at, settings)
    sensors = {sensor.channel: sensor.joints[0] for sensor in settings.joint_sensors}
    if at in sensors:
        return sensors[at]
    is_axis = any(drive.axis == at for drive in settings.drives)
    is_carried = any(body.name == at and body.joint is not None for body in settings.tree.bodies)
    return joint_at(at, settings) if is_axis or is_carried else None


def places(kind: EffectKind, settings: PlantSettings, among: tuple[str, ...] | None = None) -> list[str]:
    """Return the names of the machine's places where effects of a kind may act; `among` are kinds of places, all by default."""
    found: list[str] = []
    allowed = [each for each in kind.allowed_at if among is None or each in among]
    if "axis" in allowed:
        found += [drive.axis for drive in settings.drives]
    if "body" in allowed:
        needs_mass = kind.allowed_at == ("body",)
        bodies = settings.tree.bodies
        found += [body.name for body in bodies if (body.mass_kg > 0.0 if needs_mass else body.joint is not None) and body.name not in found]
    if "encoder" in allowed or "channel" in allowed:
        found += [encoder.channel for encoder in settings.encoders]
    if "channel" in allowed:
        found += [current.channel for current in settings.currents] + imu_channel_names(settings)
        found += [sensor.channel for sensor in settings.speeds]
    if "imu" in allowed or "channel" in allowed:
        found += [imu.name for imu in settings.imus]
    if kind.needs == "spring":
        found = [at for at in found if spring_at(at, settings) is not None]
    if kind.needs == "neighbour" and len(settings.drives) < 2:
        found = []
    return found


def is_prismatic(at: str, settings: PlantSettings) -> bool:
    """Return whether a place counts in metres and newtons.

    It does at an axis, body or encoder of a joint that slides.
    """
    kinds = {joint.name: joint.kind for joint in settings.tree.joints}
    names = {drive.axis: drive.joint for drive in settings.drives}
    for body in settings.tree.bodies:
        if body.joint is not None:
            names.setdefault(body.name, body.joint.name)
    for encoder in settings.encoders:
        names.setdefault(encoder.channel, encoder.joints[0])
    return kinds.get(names.get(at, ""), "revolute") == "prismatic"


def drive_unit(at: str, settings: PlantSettings) -> str:
    """Return the unit of the drive's effort at an axis; A elsewhere."""
    return next((drive.unit for drive in settings.drives if drive.axis == at), "A")


def _body_of_a_sensor(at: str, settings: PlantSettings) -> str | None:
    """Return the name of the body that carries an IMU or whose joint a sensor reads.

    An IMU is named by its own name or by one of its channels. None at any other place.
    """
    channels = imu_channel_names(settings)
    for n, imu in enumerate(settings.imus):
        each = len(channels) // len(settings.imus)
        if at in (imu.name, *channels[n * each : (n + 1) * each]):
            return imu.body
    joint = {sensor.channel: sensor.joints[0] for sensor in settings.joint_sensors}.get(at)
    return next((body.name for body in settings.tree.bodies if joint is not None and _joint_name(body) == joint), None)


def _joint_name(body: Body) -> str:
    return "" if body.joint is None else body.joint.name


def _body(name: str, settings: PlantSettings) -> Body:
    return next(body for body in settings.tree.bodies if body.name == name)
