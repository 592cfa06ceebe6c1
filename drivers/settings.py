"""Settings of a machine's devices for the drivers, frozen. The bench builds them from a machine file."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Literal

LoopMode = Literal["torque", "velocity", "position", "profile_velocity", "profile_position"]
"""Mode in which a drive is commanded: cyclic synchronous torque, velocity and position, and profile velocity and position, of CiA 402."""


LED_SPEED_MARGIN = 1.5
"""Multiple of its speed limit that an axis may reach under the sample loop: the reference keeps to the limit, excitation adds to it."""


@dataclass(frozen=True)
class Pdo:
    """One process data object as configured over SDO: its content and its transmission."""

    number: int  # 1..4 (or 1..512)
    cob_id: int
    transmission_type: int  # 1: every SYNC (TPDO), 1: applied at the next SYNC (RPDO)
    entries: tuple[tuple[int, int, int], ...]  # (index, subindex, bits), in order


@dataclass(frozen=True)
class Identity:
    """Identity object 1018h as the machine file expects it; a field of None is not compared."""

    vendor_id: int | None
    product_code: int | None
    revision_number: int | None
    serial_number: int | None


@dataclass(frozen=True)
class Node:
    """One CANopen node of the machine."""

    name: str  # key in [bus.nodes], e.g. "propeller_drive"
    role: str  # "drive" (CiA 402), "encoder" (CiA 406) or "imu"
    axis: str  # of an IMU: the one that moves it
    node_id: int
    eds: Path
    identity: Identity
    tpdos: tuple[Pdo, ...]
    rpdos: tuple[Pdo, ...]
    heartbeat_period_s: float
    boot_timeout_s: float
    writes: tuple[tuple[int, int, int], ...] = ()  # further (index, subindex, value) of the file, written and read back
    sensor: str = ""  # which IMU of the machine
    stopped_by: str = ""  # what stops a drive that cannot stop by itself when the bench is gone
    foreign_sdo: str = ""  # who else may send it SDO requests


@dataclass(frozen=True)
class AxisScaling:
    """Conversion between the wire and SI for one axis.

    position = sign * counts * resolution + offset; effort = sign * per mille / 1000 * rated.
    """

    axis: str
    position_resolution: float  # rad or m at the joint, per count
    link_resolution: float  # rad or m per count of the link encoder; 0 when there is none
    link_zero_counts: int  # raw count of the absolute link encoder at joint position zero
    sign: int  # +1 or -1
    rated: float  # rated current (or effort) in the drive's unit
    limit: float  # |command| the loop saturates at
    rated_torque_mNm: int  # object 6076h
    rated_current_mA: int  # object 6075h
    position_unit: str = "rad"  # or "m"; for messages
    mode: LoopMode = "torque"
    counts_per_motor_turn: float = 0.0
    velocity_unit: str = ""  # of the drive's velocities, a key of `DECLARED` or `COUNTS` (canopen/units.py); "": what its objects say
    acceleration_unit: str = ""


@dataclass(frozen=True)
class HomingSettings:
    """Homing of an axis and the checks that go with it."""

    axis: str
    method: int  # CiA 402 homing method, 37: the present position is home
    speed: float  # rad/s, for methods that move
    acceleration: float  # rad/s^2
    timeout_s: float
    agreement_tolerance: float  # rad: |motor side - link encoder| after homing
    direction_check_effort: float  # in the drive's unit, added to the holding effort
    direction_check_travel: float  # rad that the axis must move in the right direction before more is allowed
    direction_check_timeout_s: float
    travel_limit: float  # rad: how far a method that moves may move the axis before its zero is found


@dataclass(frozen=True)
class MotionLimits:
    """Limits of an axis in the ticks that the link makes by itself."""

    axis: str
    lower: float  # rad or m
    upper: float
    speed: float  # rad/s or m/s
    tracking_error: float  # rad or m: |reference - position|
    stale_ticks: int  # ticks in a row without a position that are bridged
    acceleration: float = inf  # rad/s^2 or m/s^2 of the reference, and of a drive that goes by itself
    quick_stop: float | None = None  # rad/s^2 or m/s^2 of the drive's own ramp; None: that of its data sheet, or of the node's writes
    following_error: float = 0.0  # rad or m: |target - position| in position mode, in which the target leads at speed
    holding_effort: float = inf  # drive's unit: more than this holds the axis at no pose (`hil.bench.holding`)


@dataclass(frozen=True)
class ImuPort:
    """The detector's IMU on a serial line, Xsens Xbus framing."""

    name: str
    device: str  # a path such as /dev/ttyUSB0, or tcp:HOST:PORT; "" when the bench names it
    baud: int
    triggered_by_sync: bool  # False: runs on its own clock at rate_Hz
    rate_Hz: float


@dataclass(frozen=True)
class IoWatchdog:
    """The output watchdog of the I/O device: its outputs fall unless the supervisor refreshes it (`drivers.modbus.refresh`)."""

    register: int  # holding register that shows a word and takes the one that follows
    timeout_s: float  # from the last refresh to the fall of the outputs


@dataclass(frozen=True)
class IoMap:
    """Modbus addresses of brakes, hold-to-run, door contact and temperatures, zero-based."""

    url: str  # "tcp:HOST:PORT" or "rtu:/dev/ttyUSB1@115200,8E1"; "" when the bench names it
    unit_id: int
    poll_period_s: float
    stale_after_s: float
    brake_coils: dict[str, int]  # axis -> coil; 1 releases the brake
    brake_feedback_inputs: dict[str, int]  # axis -> discrete input; 1: brake is open
    hold_to_run_input: int  # discrete input; 1: pressed
    door_input: int  # discrete input; 1: closed
    temperature_registers: dict[str, int]  # axis -> input register, int16 in 0.1 degC
    watchdog: IoWatchdog | None = None  # None: nothing but the loop and the poller closes the brakes
    hold_to_run_released_input: int | None = None  # second contact of the switch, on a discrete input; 1: released
    loop_back: tuple[int, int] | None = None  # coil and discrete input that are wired together: both live while the input follows


@dataclass(frozen=True)
class BusSettings:
    """The whole bus of a machine."""

    bitrate_bit_s: int
    sync_cob_id: int
    sync_period_s: float
    master_node_id: int  # the bench's own heartbeat
    master_heartbeat_period_s: float
    answer_timeout_s: float  # after a SYNC, how long the loop waits for the last TPDO
    nodes: tuple[Node, ...]
    scalings: tuple[AxisScaling, ...]  # in axis order
    homings: tuple[HomingSettings, ...]  # in axis order
    motions: tuple[MotionLimits, ...]  # in axis order
    imu: ImuPort | None
    io: IoMap | None
    sync_producer: str = ""  # who sends SYNC; "": the bench
    overrun_ticks: int = 0  # ticks without that SYNC that are bridged
