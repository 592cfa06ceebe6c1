"""The machine file's tables: bodies, drives, sensors, controller, limits, geometry. Every key: docs/machine-file.md."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.machine.schema_bus import BusTable
from hil.machine.table import Flag, Name, NotNegative, Number, Positive, Table, Text, Vector, Whole
from hil.machine.units import CONSTANT_UNITS, EFFORT_DIMENSIONS, Quantity

Section = tuple[Number, Number, Number, Number, Number, Number]
Count = Annotated[Whole, Field(gt=0, le=2**40)]


class JointTable(Table):
    """[body.joint]: how a body moves against its parent."""

    name: Name
    type: Literal["revolute", "prismatic"]
    axis: Vector
    stiffness: Annotated[NotNegative, Quantity("rotational_stiffness", "stiffness")] = 0.0
    damping: Annotated[NotNegative, Quantity("rotational_damping", "damping")] = 0.0
    rest_position: Annotated[Number, Quantity("angle", "length")] = 0.0
    brake_effort: Annotated[NotNegative, Quantity("torque", "force")] = 0.0


class BodyTable(Table):
    """[[body]]: one rigid body."""

    name: Name
    parent: Name
    position: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    orientation: Annotated[Vector, Quantity("angle")] = (0.0, 0.0, 0.0)
    mass: Annotated[NotNegative, Quantity("mass")]
    center_of_mass: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    inertia: Annotated[Section, Quantity("inertia")] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    joint: JointTable | None = None


class TimingTable(Table):
    """[timing]: sample rate, plant steps, and when the loop gives up."""

    sample_rate: Annotated[Positive, Quantity("frequency"), Field(le=20_000.0)]
    substeps: Annotated[Whole, Field(ge=1, le=1000)]
    sync_order: tuple[Literal["apply_targets"], Literal["latch"], Literal["advance"]] = ("apply_targets", "latch", "advance")
    overrun: Literal["skip", "wait"] = "skip"
    overrun_ticks: Annotated[Whole, Field(ge=0, le=10_000)] = 8
    stale_ticks: Annotated[Whole, Field(ge=0, le=10_000)] = 3


class DriveTable(Table):
    """[drives.AXIS]: motor, gear, and what the command means."""

    joint: Name
    effort_unit: Literal["A", "V", "Nm", "N"]
    constant: Positive
    constant_unit: Literal[tuple(CONSTANT_UNITS)]  # type: ignore[valid-type]
    ratio: Positive = 1.0
    rotor_inertia: Annotated[NotNegative, Quantity("inertia")] = 0.0
    rotor_mass: Annotated[NotNegative, Quantity("mass")] = 0.0
    rated_current: Annotated[Positive | None, Quantity("current")] = None
    rated_effort: Annotated[Positive | None, Quantity("voltage", "torque", "force")] = None
    limit: Annotated[Positive, Quantity(*EFFORT_DIMENSIONS)]
    target_resolution: Annotated[NotNegative, Quantity("share", *EFFORT_DIMENSIONS)] = 0.0
    encoder_counts_per_motor_turn: Count | None = None
    direction: Literal[1, -1] = 1


class EncoderTable(Table):
    """[sensors.position_AXIS] and [sensors.link_position_AXIS]."""

    type: Literal["encoder"]
    joints: Annotated[tuple[Name, ...], Field(min_length=1)]
    kind: Literal["incremental", "absolute"]
    resolution: Annotated[NotNegative | None, Quantity("angle", "length")] = None
    counts_per_turn: Count | None = None


class SpeedTable(Table):
    """[sensors.speed_AXIS]."""

    type: Literal["speed"]
    joints: Annotated[tuple[Name, ...], Field(min_length=1)]
    resolution: Annotated[NotNegative, Quantity("angular_speed", "speed")] = 0.0


class CurrentTable(Table):
    """[sensors.current_AXIS] or [sensors.effort_AXIS]."""

    type: Literal["current"]
    axis: Name
    resolution: Annotated[NotNegative, Quantity(*EFFORT_DIMENSIONS)] = 0.0
    noise_rms: Annotated[NotNegative, Quantity(*EFFORT_DIMENSIONS)] = 0.0


class ImuTable(Table):
    """[sensors.imu]."""

    type: Literal["imu"]
    body: Name
    position: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    orientation: Annotated[Vector, Quantity("angle")] = (0.0, 0.0, 0.0)
    accelerometer_noise_rms: Annotated[tuple[NotNegative, NotNegative, NotNegative], Quantity("acceleration")] = (0.0, 0.0, 0.0)
    accelerometer_bias: Annotated[Vector, Quantity("acceleration")] = (0.0, 0.0, 0.0)
    accelerometer_bandwidth: Annotated[NotNegative, Quantity("frequency")] = 0.0
    accelerometer_resolution: Annotated[NotNegative, Quantity("acceleration")] = 0.0
    gyro_noise_rms: Annotated[tuple[NotNegative, NotNegative, NotNegative], Quantity("angular_speed")] = (0.0, 0.0, 0.0)
    gyro_bias: Annotated[Vector, Quantity("angular_speed")] = (0.0, 0.0, 0.0)
    gyro_bandwidth: Annotated[NotNegative, Quantity("frequency")] = 0.0
    gyro_resolution: Annotated[NotNegative, Quantity("angular_speed")] = 0.0


class TemperatureTable(Table):
    """[sensors.temperature_AXIS]."""

    type: Literal["temperature"]
    axis: Name
    ambient: Annotated[Number, Field(ge=-50, le=150), Quantity("temperature")]
    rise: Annotated[NotNegative, Quantity("heating")]
    time_constant: Annotated[Positive, Quantity("time")]
    resolution: Annotated[NotNegative, Quantity("temperature_step")] = 0.0


SensorTable = Annotated[EncoderTable | SpeedTable | CurrentTable | ImuTable | TemperatureTable, Field(discriminator="type")]


class ControllerTable(Table):
    """[controller.AXIS]: second-order sections at the sample rate."""

    position_sections: Annotated[tuple[Section, ...], Field(min_length=1)]
    reference_sections: Annotated[tuple[Section, ...], Field(min_length=1)] | None = None
    gravity_feedforward: Flag = False


class LimitsTable(Table):
    """[limits.AXIS]: what references and positions are held against."""

    range: Annotated[tuple[Number, Number], Quantity("angle", "length")]
    speed: Annotated[Positive, Quantity("angular_speed", "speed")]
    acceleration: Annotated[Positive, Quantity("angular_acceleration", "acceleration")]
    jerk: Annotated[Positive, Quantity("angular_jerk", "jerk")]
    tracking_error: Annotated[Positive, Quantity("angle", "length")]


class GeometryTable(Table):
    """[geometry]: source and detector, for imaging."""

    isocenter: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    source_body: Name
    source_position: Annotated[Vector, Quantity("length")]
    detector_body: Name
    detector_center: Annotated[Vector, Quantity("length")]
    detector_size: Annotated[tuple[Positive, Positive], Quantity("length")]
    detector_pixels: tuple[Count, Count]


class MachineTable(Table):
    """The whole file."""

    format: Literal[1]
    name: Name
    description: Text = ""
    gravity: Annotated[Vector, Quantity("acceleration")] = (0.0, 0.0, -9.81)
    timing: TimingTable
    body: Annotated[tuple[BodyTable, ...], Field(min_length=1)]
    drives: Annotated[dict[Name, DriveTable], Field(min_length=1)]
    sensors: dict[Name, SensorTable]
    controller: Annotated[dict[Name, ControllerTable], Field(default_factory=dict)]
    limits: Annotated[dict[Name, LimitsTable], Field(default_factory=dict)]
    geometry: GeometryTable | None = None
    bus: BusTable | None = None
