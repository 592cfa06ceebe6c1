"""The tables of a machine file: bodies, drives, sensors, controller, limits, geometry. docs/generated/machine-file.md is made from them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.machine.schema_budgets import BudgetsTable
from hil.machine.schema_bus import BusTable
from hil.machine.schema_judging import JudgingTable
from hil.machine.table import Flag, MachineName, Name, NotNegative, Number, Positive, Table, Text, Vector, Whole
from hil.machine.units import CONSTANT_UNITS, EFFORT_DIMENSIONS, Quantity

Section = tuple[Number, Number, Number, Number, Number, Number]
Count = Annotated[Whole, Field(gt=0, le=2**40)]


class JointTable(Table):
    """Table `[body.joint]`: how a body moves against its parent.

    A body without this table is welded to its parent.
    """

    name: Name
    """Unique name. An actuated joint usually bears the name of its axis."""
    type: Literal["revolute", "prismatic"]
    """Whether the joint turns or slides."""
    axis: Vector
    """Unit vector in the body's frame, through the body's origin: the axis of rotation or the direction of travel."""
    stiffness: Annotated[NotNegative, Quantity("rotational_stiffness", "stiffness")] = 0.0
    """Stiffness of a spring towards `rest_position`; 0 is no spring."""
    damping: Annotated[NotNegative, Quantity("rotational_damping", "damping")] = 0.0
    """Viscous damping."""
    rest_position: Annotated[Number, Quantity("angle", "length")] = 0.0
    """Joint position at which the spring is unloaded."""
    brake_effort: Annotated[NotNegative, Quantity("torque", "force")] = 0.0
    """Effort that the closed brake of the joint holds; 0 is no brake."""
    brake_delay: Annotated[NotNegative, Quantity("time")] = 0.04
    """Time from the brake's command to that effort. Spring-applied brakes take 30 to 60 ms."""


class BodyTable(Table):
    """Table `[[body]]`: one rigid body of the plant's tree.

    A parent is listed before its children.
    """

    name: Name
    """Unique name."""
    parent: Name
    """A body listed above, or `"world"`."""
    position: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    """Origin of the body's frame in the parent's frame, at joint position zero."""
    orientation: Annotated[Vector, Quantity("angle")] = (0.0, 0.0, 0.0)
    """Extrinsic x, y, z angles of the body's frame in the parent's frame."""
    mass: Annotated[NotNegative, Quantity("mass")]
    """Mass; above zero for a body with a joint."""
    center_of_mass: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    """Centre of mass in the body's frame."""
    inertia: Annotated[Section, Quantity("inertia")] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass, in the body's frame. Required for a body with mass that turns; positive
    definite, with the triangle inequality."""
    joint: JointTable | None = None
    """How the body moves; without it the body is welded to its parent."""


class TimingTable(Table):
    """Table `[timing]`: sample rate, plant steps, and what a loop does that comes late."""

    sample_rate: Annotated[Positive, Quantity("frequency"), Field(le=20_000.0)]
    """Rate of the sample loop and of SYNC."""
    substeps: Annotated[Whole, Field(ge=1, le=1000)]
    """Steps of the plant's integration per sample."""
    sync_order: tuple[Literal["apply_targets"], Literal["latch"], Literal["advance"]] = ("apply_targets", "latch", "advance")
    """What the drives do at a SYNC, in this order. The value is fixed; it may stand in the file so that a reader sees it."""
    overrun: Literal["skip", "wait"] = "skip"
    """What the loop does when it is a period or more late. `"skip"` leaves out the lost ticks, counts them and keeps the wall's time.
    `"wait"` loses none: all later ticks move by as much, and time-outs stand still meanwhile, as an emulated machine does. Use it for
    emulated machines on a computer that stalls."""
    overrun_ticks: Annotated[Whole, Field(ge=0, le=10_000)] = 8
    """Ticks lost at once that the loop skips and counts; more stop the motors."""
    stale_ticks: Annotated[Whole, Field(ge=0, le=10_000)] = 3
    """Ticks in a row in which a missing position is replaced by the last one; more stop the motors."""
    recorder_stalls: Literal["stop", "go_on"] = "stop"
    """What follows when the recorder of a run has stood still for a second: it was halted or hangs, and a crash would now cost more rows
    than that. `"stop"` stops the motors. `"go_on"` says so at once and goes on: rows wait in memory, two minutes of them at 256 Hz."""


class LoopsTable(Table):
    """Table `[drives.AXIS.loops]`: the drive's own position and velocity loops, as they are set in the drive, seen at the joint.

    Effort is the velocity loop's gain times demanded less measured speed, and the integral of it times its gain; the position loop demands
    its gain times target less position. They run at the sample rate here, and in a real drive faster.
    """

    position_gain: NotNegative
    """Gain of the position loop [1/s]."""
    velocity_gain: Positive
    """Gain of the velocity loop: `effort_unit` per rad/s or m/s at the joint."""
    velocity_integral_gain: NotNegative
    """Its integral gain: `effort_unit` per rad or m at the joint."""
    speed_filter: Annotated[Number, Field(gt=0, le=1)] = 0.25
    """Share of the newest difference of positions in the measured speed, a first-order filter at the sample rate; 1 is no filter."""
    torque_sections: Annotated[tuple[Section, ...], Field(min_length=1)] | None = None
    """Filter of the velocity loop's effort, a notch say, as second-order sections at the sample rate with a static gain of 1."""


class DriveTable(Table):
    """Table `[drives.AXIS]`: motor, gear, and what the command means.

    The order of these tables is the order of the machine's axes.
    """

    joint: Name
    """The joint that the drive moves; one drive a joint."""
    effort_unit: Literal["A", "V", "Nm", "N"]
    """Unit of the drive's command."""
    constant: Positive
    """Motor effort per unit of command, in `constant_unit`."""
    constant_unit: Literal[tuple(CONSTANT_UNITS)]  # type: ignore[valid-type]
    """Unit of `constant`."""
    ratio: Positive = 1.0
    """Motor turns per joint turn; for a rotary motor on a prismatic joint, motor radians per metre."""
    rotor_inertia: Annotated[NotNegative, Quantity("inertia")] = 0.0
    """Inertia of a rotary motor; times ratio squared it is the joint's armature."""
    rotor_mass: Annotated[NotNegative, Quantity("mass")] = 0.0
    """Moving mass of a linear motor; times ratio squared it is the joint's armature."""
    rated_current: Annotated[Positive | None, Quantity("current")] = None
    """For a drive commanded in ampere: what per-mille values on the wire refer to. Required with a bus or a resolution per mille."""
    rated_effort: Annotated[Positive | None, Quantity("voltage", "torque", "force")] = None
    """The same for a drive commanded in V, Nm or N."""
    limit: Annotated[Positive, Quantity(*EFFORT_DIMENSIONS)]
    """Effort at which commands are saturated."""
    target_resolution: Annotated[NotNegative, Quantity("share", *EFFORT_DIMENSIONS)] = 0.0
    """Smallest step of the target, in per mille or per cent of the rated effort or in units of effort; 0 is none."""
    encoder_counts_per_motor_turn: Count | None = None
    """Counts of the motor's incremental encoder per turn."""
    mode: Literal["torque", "velocity", "position", "profile_velocity", "profile_position"] = "torque"
    """What is commanded: cyclic synchronous torque, velocity or position of CiA 402. In velocity and position mode the drive's own `loops`
    are part of the feedback; excitation and feedforward are efforts and go into `torque_offset`. The profile modes are for drives that have
    no cyclic ones: the drive ramps its velocity, or goes to a pose by itself (`isocenter move`)."""
    loops: LoopsTable | None = None
    """The drive's own loops. Required in every mode but torque."""
    velocity_unit: Literal["counts/s", "0.1 counts/s", "rpm", "0.1 rpm", "0.01 rpm", "0.001 rpm", "rev/s"] | None = None
    """Unit of the drive's velocities; turns are the motor's, or behind the drive's own gear ratio (6091h). Without it, what 60A9h or 6096h
    of its data sheet say, else counts/s. A drive whose objects say another one is refused."""
    acceleration_unit: Literal["counts/s^2", "10 counts/s^2", "rpm/s", "rev/s^2"] | None = None
    """Unit of the drive's accelerations. Without it, what 60AAh or 6097h say, else its velocity unit per second."""
    direction: Literal[1, -1] = 1
    """-1 for a drive whose positive direction is the joint's negative one. It is applied between the wire and SI values only."""


class EncoderTable(Table):
    """Tables `[sensors.position_AXIS]` and `[sensors.link_position_AXIS]`, `type = "encoder"`: position of an axis.

    `position_AXIS` is on the motor side and required for every axis of a machine with `[controller]`. `link_position_AXIS` is on the link.
    Give `resolution` or `counts_per_turn`. Without either, the resolution is 2π / (`encoder_counts_per_motor_turn` × `ratio`).
    """

    type: Literal["encoder"]
    """Kind of sensor."""
    joints: Annotated[tuple[Name, ...], Field(min_length=1)]
    """The joints whose sum the encoder sees; the axis's own joint is one of them."""
    kind: Literal["incremental", "absolute"]
    """An incremental encoder has to be homed, an absolute one has not."""
    resolution: Annotated[NotNegative | None, Quantity("angle", "length")] = None
    """Angle or length per count; 0 is none."""
    counts_per_turn: Count | None = None
    """Counts per turn of the joint, for revolute joints."""


class SpeedTable(Table):
    """Table `[sensors.speed_AXIS]`, `type = "speed"`: a speed sensor, for machines without `[bus]`."""

    type: Literal["speed"]
    """Kind of sensor."""
    joints: Annotated[tuple[Name, ...], Field(min_length=1)]
    """The joints whose summed speed the sensor sees; the axis's own joint is one of them."""
    resolution: Annotated[NotNegative, Quantity("angular_speed", "speed")] = 0.0
    """Step of the reading; 0 is none."""


class CurrentTable(Table):
    """Table `[sensors.current_AXIS]`, `type = "current"`: what the drive measures.

    It is called `[sensors.effort_AXIS]` where the drive is not commanded in ampere.
    """

    type: Literal["current"]
    """Kind of sensor."""
    axis: Name
    """The axis whose drive measures."""
    resolution: Annotated[NotNegative, Quantity(*EFFORT_DIMENSIONS)] = 0.0
    """Step of the reading; 0 is none."""
    noise_rms: Annotated[NotNegative, Quantity(*EFFORT_DIMENSIONS)] = 0.0
    """Standard deviation of the noise, per sample."""


class ImuTable(Table):
    """Table `[sensors.imu]`, `type = "imu"`: accelerometer and gyroscope on a body; a further one is `[sensors.imu_NAME]`.

    Its channels are `imu_x`, `imu_y`, `imu_z`, `gyro_x`, `gyro_y` and `gyro_z`; of a further one `imu_NAME_x` to `gyro_NAME_z`. An observer
    takes the one on `geometry.source_body` for the motion of the focal spot.
    """

    type: Literal["imu"]
    """Kind of sensor."""
    body: Name
    """The body that carries the sensor."""
    position: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    """Place of the sensor in the body's frame."""
    orientation: Annotated[Vector, Quantity("angle")] = (0.0, 0.0, 0.0)
    """Extrinsic x, y, z angles of the sensor's frame in the body's frame."""
    accelerometer_noise_rms: Annotated[tuple[NotNegative, NotNegative, NotNegative], Quantity("acceleration")] = (0.0, 0.0, 0.0)
    """Standard deviation of the accelerometer's noise, per axis and sample."""
    accelerometer_bias: Annotated[Vector, Quantity("acceleration")] = (0.0, 0.0, 0.0)
    """Constant error of the accelerometer."""
    accelerometer_bandwidth: Annotated[NotNegative, Quantity("frequency")] = 0.0
    """Corner of the accelerometer's first-order low pass; 0 is none."""
    accelerometer_resolution: Annotated[NotNegative, Quantity("acceleration")] = 0.0
    """Step of the accelerometer's reading; 0 is none."""
    accelerometer_range: Annotated[Positive | None, Quantity("acceleration")] = None
    """Full scale of the accelerometer, either way; a reading there is none. Not emulated."""
    gyro_noise_rms: Annotated[tuple[NotNegative, NotNegative, NotNegative], Quantity("angular_speed")] = (0.0, 0.0, 0.0)
    """Standard deviation of the gyroscope's noise, per axis and sample."""
    gyro_bias: Annotated[Vector, Quantity("angular_speed")] = (0.0, 0.0, 0.0)
    """Constant error of the gyroscope."""
    gyro_bandwidth: Annotated[NotNegative, Quantity("frequency")] = 0.0
    """Corner of the gyroscope's first-order low pass; 0 is none."""
    gyro_resolution: Annotated[NotNegative, Quantity("angular_speed")] = 0.0
    """Step of the gyroscope's reading; 0 is none."""
    gyro_range: Annotated[Positive | None, Quantity("angular_speed")] = None
    """Full scale of the gyroscope, either way; a reading there is none. Not emulated."""


class TemperatureTable(Table):
    """Table `[sensors.temperature_AXIS]`, `type = "temperature"`: temperature of a winding."""

    type: Literal["temperature"]
    """Kind of sensor."""
    axis: Name
    """The axis whose winding is measured."""
    ambient: Annotated[Number, Field(ge=-50, le=150), Quantity("temperature")]
    """Temperature at which the winding starts."""
    rise: Annotated[NotNegative, Quantity("heating")]
    """Steady rise per squared command."""
    time_constant: Annotated[Positive, Quantity("time")]
    """Time constant of the winding."""
    resolution: Annotated[NotNegative, Quantity("temperature_step")] = 0.0
    """Step of the reading; 0 is none."""


SensorTable = Annotated[EncoderTable | SpeedTable | CurrentTable | ImuTable | TemperatureTable, Field(discriminator="type")]


class ControllerTable(Table):
    """Table `[controller.AXIS]`: the feedback law as second-order sections at the sample rate.

    The command is u = C_r r - C_y y + w + feedforward, with reference r, position y and excitation w. Every axis has this table, or none
    has; a machine without `[controller]` is open loop, and its simulation takes the recorded command as input. A section is a row
    b0, b1, b2, 1, a1, a2; a cascade goes from rad or m to the drive's unit.

    Where the drive is commanded in velocity, C_r r - C_y y is a speed, and in position a correction of the reference [rad or m]. An axis
    that is commanded in position needs no such table.
    """

    position_sections: Annotated[tuple[Section, ...], Field(min_length=1)] | None = None
    """C_y, from the measured position. Required, but for an axis that is commanded in position."""
    reference_sections: Annotated[tuple[Section, ...], Field(min_length=1)] | None = None
    """C_r, from the reference. Without it C_r = C_y, run as one filter on r - y."""
    gravity_feedforward: Flag = False
    """Add the static holding effort of the machine file at the reference to the command."""


class LimitsTable(Table):
    """Table `[limits.AXIS]`: what references and positions are held against."""

    range: Annotated[tuple[Number, Number], Quantity("angle", "length")]
    """Lowest and highest position, of references and of the measured position."""
    speed: Annotated[Positive, Quantity("angular_speed", "speed")]
    """Highest speed that a reference may ask for."""
    acceleration: Annotated[Positive, Quantity("angular_acceleration", "acceleration")]
    """Highest acceleration that a reference may ask for."""
    jerk: Annotated[Positive, Quantity("angular_jerk", "jerk")]
    """Highest jerk that a reference may ask for."""
    tracking_error: Annotated[Positive, Quantity("angle", "length")]
    """Difference of reference and position at which the loop stops the motors."""
    quick_stop: Annotated[Positive | None, Quantity("angular_acceleration", "acceleration")] = None
    """Deceleration of the drive's own quick stop ramp, for `[budgets]`; it is written to object 6085h in the drive's unit, where the drive
    has it, and refused beside a `write` of it. Without it, the value of such a `write`, else the default of the EDS, which is written,
    too."""


class GeometryTable(Table):
    """Table `[geometry]`: X-ray source and detector, for imaging."""

    isocenter: Annotated[Vector, Quantity("length")] = (0.0, 0.0, 0.0)
    """Isocentre in the world."""
    source_body: Name
    """The body that carries the tube."""
    source_position: Annotated[Vector, Quantity("length")]
    """Focal spot, in the frame of its body."""
    detector_body: Name
    """The body that carries the detector."""
    detector_center: Annotated[Vector, Quantity("length")]
    """Centre of the detector's active area, in the frame of its body."""
    detector_size: Annotated[tuple[Positive, Positive], Quantity("length")]
    """Width and height of the active area."""
    detector_pixels: tuple[Count, Count]
    """Columns and rows of the active area."""


class MachineTable(Table):
    """The top level of the file.

    A machine without `[bus]` can be simulated, compared and diagnosed, but not run. With `[bus]` every axis needs `[controller]` and
    `[limits]`.
    """

    format: Literal[1]
    """Format of the file."""
    name: MachineName
    """Name of the machine."""
    description: Text = ""
    """One line for people."""
    gravity: Annotated[Vector, Quantity("acceleration")] = (0.0, 0.0, -9.81)
    """Gravity in the world."""
    timing: TimingTable
    """Sample rate and timing."""
    body: Annotated[tuple[BodyTable, ...], Field(min_length=1)]
    """The bodies, parents first."""
    drives: Annotated[dict[Name, DriveTable], Field(min_length=1)]
    """The drives, by axis."""
    sensors: dict[Name, SensorTable]
    """The sensors, by channel."""
    controller: Annotated[dict[Name, ControllerTable], Field(default_factory=dict)]
    """The controllers, by axis."""
    limits: Annotated[dict[Name, LimitsTable], Field(default_factory=dict)]
    """The limits, by axis."""
    geometry: GeometryTable | None = None
    """Source and detector."""
    bus: BusTable | None = None
    """What is on the wires."""
    budgets: Annotated[dict[Name, BudgetsTable], Field(default_factory=dict)]
    """Time and travel to standstill, by axis."""
    judging: JudgingTable | None = None
    """What is allowed of the sensors in a run."""
    effect: Annotated[tuple[dict[Name, Number | Text | tuple[Number, Number]], ...], Field(default=())]
    """Physics of the catalogue that this machine has: friction, play, cables. One `[[effect]]` table each, with the keys of an effects
    file. What `--effects` adds comes beside them."""
    tolerances: Annotated[dict[Name, dict[Name, Positive]], Field(default_factory=dict)]
    """By how much numbers of bodies, joints, drives and sensors may be wrong at most, in their own units: `arm = { mass_kg = 0.5,
    center_of_mass_y_m = 0.02, inertia_xz_kg_m2 = 0.1 }`. A diagnosis re-tunes numbers within these bounds, also such as are zero. Without
    one, numbers that are not zero may be wrong by 15 %."""
