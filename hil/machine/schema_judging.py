"""The machine file's [judging] tables: what is allowed of each sensor, and what follows where it is not kept."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.machine.table import Name, Number, Positive, Table, Whole
from hil.machine.units import Quantity

FollowsKey = Literal["stop", "mark"]


class ImuJudgingTable(Table):
    """Table `[judging.imu]`: age, rate, range and life of the IMU on the bus.

    Readings at full scale are found where `[sensors.imu]` says `accelerometer_range` and `gyro_range`.
    """

    follows: FollowsKey = "mark"
    """What follows a finding: `"stop"` stops the motors; `"mark"` goes on and marks the rows in the channel `sensor_marks`."""
    age: Annotated[Positive | None, Quantity("time")] = None
    """Age of the newest packet. Without it, as many packets may be missing as `stale_ticks` bridges."""
    rate_tolerance: Annotated[Number, Field(gt=0.0, lt=1.0), Quantity("share")] = 0.1
    """Share by which the packets of a second may depart from `rate`."""
    frozen_packets: Annotated[Whole, Field(ge=2, le=10_000)] = 8
    """Packets in a row with one value after which a channel is frozen; more where noise and resolution need more for
    `false_alarm_probability`. A channel without noise is not judged."""
    damaged_per_s: Annotated[Whole, Field(ge=0, le=1_000_000)] = 2
    """Messages within a second that may fail their checksum. On a sound line one in some thousand seconds does."""
    force_tolerance: Annotated[Positive | None, Quantity("acceleration")] = None
    """Difference between the mean specific force of half a second and what the machine file makes of the axes' motion. Not judged without
    it."""
    turn_tolerance: Annotated[Positive | None, Quantity("angular_speed")] = None
    """The same of the angular rate."""


class EncodersJudgingTable(Table):
    """Table `[judging.encoders.AXIS]`: motor side and link encoder of an axis, compared.

    The link is expected ahead of the motor side by what the spring between both carries, from the measured effort and the motion. An
    encoder that steps further than the drive's greatest effort could move it has jumped.
    """

    follows: FollowsKey = "mark"
    """As for the IMU. Beyond `tracking_error` the motors are stopped in any case."""
    tolerance: Annotated[Positive | None, Quantity("angle", "length")] = None
    """Difference of both beyond the windup. Without it, the `agreement_tolerance` of homing."""
    drift: Annotated[Positive | None, Quantity("angle", "length")] = None
    """Growth of that difference since the session began, while it goes on growing. Without it, a tenth of `tolerance`."""


class TemperatureJudgingTable(Table):
    """Table `[judging.temperature.AXIS]`: the thermometer of an axis; a broken wire is found in any case."""

    follows: FollowsKey = "stop"
    """As for the IMU. A winding of unknown temperature may be a hot one."""
    limit: Annotated[Number | None, Field(ge=-50, le=400), Quantity("temperature")] = None
    """Highest temperature; none without it."""
    rate: Annotated[Positive | None, Quantity("temperature_rate")] = None
    """Fastest change. Without it, what the drive's greatest effort makes: `rise` times `limit` squared over `time_constant`."""


class DriveJudgingTable(Table):
    """Table `[judging.drive.AXIS]`: the warning bit of the drive's statusword, the effort that it measures, and the axis's load.

    The measured effort must lie between the commands of the last `settling`. Noise and resolution of `[sensors.current_AXIS]` are allowed
    besides.
    """

    follows: FollowsKey = "mark"
    """As for the IMU. A drive that measures no effort where it was sent some, or one that is off by a fifth of the rated effort, stops the
    motors in any case; so does the `tracking_error`."""
    effort_tolerance: Annotated[Number, Field(gt=0.0, le=1.0), Quantity("share")] = 0.05
    """Share of the rated effort by which a drive may be off: what current sensors of drives are off by, and some more."""
    settling: Annotated[Positive, Quantity("time")] = 0.01
    """Time within which the drive's effort follows its command."""
    load_tolerance: Annotated[Number | None, Field(gt=0.0, le=10.0), Quantity("share")] = None
    """Share of the rated effort by which the effort of half a second may differ from what the machine file makes of the motion: gravity,
    inertia, friction. Not judged without it."""


class JudgingTable(Table):
    """Table `[judging]`: the sensors of a machine with `[bus]`, judged at every tick of a run.

    Everything is judged with the defaults where a table is left out.
    """

    false_alarm_probability: Annotated[Number, Field(gt=0.0, lt=0.1)] = 1e-6
    """Chance that one check finds a sound sensor wrong within an hour; thresholds against noise follow from it."""
    imu: Annotated[ImuJudgingTable, Field(default_factory=lambda: ImuJudgingTable.model_validate({}))]
    """The IMU."""
    encoders: Annotated[dict[Name, EncodersJudgingTable], Field(default_factory=dict)]
    """Encoders, by axis."""
    temperature: Annotated[dict[Name, TemperatureJudgingTable], Field(default_factory=dict)]
    """Thermometers, by axis."""
    drive: Annotated[dict[Name, DriveJudgingTable], Field(default_factory=dict)]
    """Drives, by axis."""
