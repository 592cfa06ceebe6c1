"""The machine file's [bus] tables: CANopen nodes, homing, the serial IMU, Modbus inputs and outputs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.machine.table import Flag, Name, Number, Positive, Table, Text, Whole
from hil.machine.units import EFFORT_DIMENSIONS, Quantity

Seconds = Annotated[Positive, Quantity("time")]
NodeId = Annotated[Whole, Field(ge=1, le=127)]
CobId = Annotated[Whole, Field(ge=0x001, le=0x7FF)]
Unsigned32 = Annotated[Whole, Field(ge=0, le=0xFFFF_FFFF)]
Address = Annotated[Whole, Field(ge=0, le=65535)]


class PdoTable(Table):
    """Tables `[[bus.nodes.NAME.tpdo]]` and `[[bus.nodes.NAME.rpdo]]`: one process data object.

    The TPDOs of a drive hold at least `statusword` and `position_actual_value`, its RPDOs `controlword` and `target_torque`. The TPDOs of
    an encoder hold `position_value`, those of an IMU `specific_force_x` to `angular_rate_z` and `sample_counter`.
    A PDO maps at most eight bytes.
    """

    number: Annotated[Whole, Field(ge=1, le=512)]
    """Number of the PDO in the node."""
    cob_id: CobId
    """Its identifier on the bus: unique, outside the ranges that CiA 301 reserves."""
    transmission_type: Annotated[Whole, Field(ge=0, le=255)]
    """When it is sent; 1 is at every SYNC."""
    map: Annotated[tuple[Text, ...], Field(min_length=1, max_length=64)]
    """The objects it carries, in order: by name, or as `"0x6064:00:32"` (index, subindex, bits)."""


class WriteTable(Table):
    """Table `[[bus.nodes.NAME.write]]`: a further object that is written and read back when the node is configured."""

    index: Annotated[Whole, Field(ge=0x1000, le=0xFFFF)]
    """Index of the object."""
    subindex: Annotated[Whole, Field(ge=0, le=255)] = 0
    """Its subindex."""
    value: Annotated[Whole, Field(ge=-(2**31), le=0xFFFF_FFFF)]
    """The value."""


class NodeTable(Table):
    """Table `[bus.nodes.NAME]`: one CANopen device."""

    role: Literal["drive", "encoder", "imu"]
    """A CiA 402 drive, a CiA 406 encoder for an axis with a `link_position` sensor, or an IMU; one IMU a bus."""
    axis: Name
    """The axis it belongs to, one drive an axis; of an IMU the axis that moves it."""
    sensor: Name | None = None
    """Which IMU of `[sensors]`; of an IMU only."""
    node_id: NodeId
    """Its node number; numbers differ."""
    eds: Annotated[Text, Field(min_length=1)]
    """EDS or DCF file, looked for beside the machine file, then among the shipped ones."""
    vendor_id: Unsigned32 | None = None
    """Vendor of object 1018h; not compared where it is left out."""
    product_code: Unsigned32 | None = None
    """Product of object 1018h; not compared where it is left out."""
    revision_number: Unsigned32 | None = None
    """Revision of object 1018h; not compared where it is left out."""
    serial_number: Unsigned32 | None = None
    """Serial number of object 1018h; not compared where it is left out."""
    heartbeat: Seconds
    """Period of its heartbeat."""
    boot_timeout: Seconds
    """How long it may take to appear on the bus."""
    zero_counts: Annotated[Whole, Field(ge=0, le=0xFFFF_FFFF)] = 0
    """Raw count of a link encoder at joint position zero."""
    tpdo: tuple[PdoTable, ...] = ()
    """What it sends."""
    rpdo: tuple[PdoTable, ...] = ()
    """What it receives."""
    write: tuple[WriteTable, ...] = ()
    """Further objects to write."""
    stopped_by: Text = ""
    """What stops the motor when the bench is gone, in words, of a drive that lacks the heartbeat consumer (1016h) or its reaction (6007h,
    605Eh). Without it such a drive is refused."""
    foreign_sdo: Text = ""
    """Who else may send it SDO requests while the machine runs, in words, such as the maker's tool that logs its temperature. Without it
    such a request ends the run. What was configured is read back in either case."""


class HomingTable(Table):
    """Table `[bus.homing.AXIS]`: how an axis finds its zero, and what is checked on the way.

    Before anything else moves, the direction check applies an effort beyond the holding effort. A travel in the right direction must
    follow.
    """

    method: Annotated[Whole, Field(ge=-128, le=37)]
    """Homing method of CiA 402. With 35 and 37 the present position is home, and with 0 the drive is not homed. They are for axes with a
    link encoder on the bus, which then says where the axis is."""
    speed: Annotated[Positive, Quantity("angular_speed", "speed")]
    """Speed of methods that move."""
    acceleration: Annotated[Positive, Quantity("angular_acceleration", "acceleration")]
    """Acceleration of methods that move."""
    timeout: Seconds
    """How long homing may take."""
    agreement_tolerance: Annotated[Positive, Quantity("angle", "length")]
    """Largest difference between motor side and link encoder afterwards."""
    direction_check_effort: Annotated[Positive, Quantity(*EFFORT_DIMENSIONS)]
    """Effort of the direction check beside the holding effort, above dry friction; up to twice where `_between` leaves the load open."""
    direction_check_travel: Annotated[Positive, Quantity("angle", "length")]
    """Travel that must follow."""
    direction_check_timeout: Seconds
    """In which time it must follow."""
    travel_limit: Annotated[Positive | None, Quantity("angle", "length")] = None
    """How far a method may lead the axis before its zero is found. Without it, the width of the axis's range."""


class ImuPortTable(Table):
    """Table `[bus.imu]`: the serial port of an IMU."""

    sensor: Name
    """Which IMU of `[sensors]`."""
    device: Text = ""
    """Serial device, or `tcp:HOST:PORT` of a serial device server in raw mode. Empty where the command line or the emulator says it."""
    baud: Annotated[Whole, Field(ge=1200, le=4_000_000)]
    """Baud rate."""
    triggered_by_sync: Flag
    """Sampled at SYNC; otherwise on its own clock at `rate`."""
    rate: Annotated[Number, Field(gt=0, le=2000), Quantity("frequency")]
    """Sample rate of the sensor."""


class WatchdogTable(Table):
    """Table `[bus.io.watchdog]`: the device's outputs fall unless the supervisor refreshes them."""

    holding_register: Address
    """Register that shows a word and takes the one that follows."""
    timeout: Seconds
    """Time from the last refresh to the fall of the outputs; at least four poll periods, at most a second."""


class LoopBackTable(Table):
    """Table `[bus.io.loop_back]`: an output of the I/O device that is wired to an input of it.

    Every poll switches the output, and the input must follow within two polls. Otherwise the state that was read counts for nothing, as if
    the device had not answered: its inputs are frozen, or its outputs do not work.
    """

    coil: Address
    """The output."""
    input: Address
    """The discrete input that it is wired to."""


class IoTable(Table):
    """Table `[bus.io]`: Modbus inputs and outputs. Addresses count from zero."""

    url: Text = ""
    """`tcp:HOST:PORT`, `rtu:DEVICE@BAUD`, or `rtu:DEVICE@BAUD,8N1` with data bits, parity (N, E, O) and stop bits; 8E1 is the standard's
    default. Empty where the command line or the emulator says it."""
    unit_id: Annotated[Whole, Field(ge=1, le=247)]
    """Modbus unit."""
    poll_period: Seconds
    """Period of polling."""
    stale_after: Seconds
    """Age of the last answer at which the loop stops."""
    brake_coils: dict[Name, Address]
    """Coil of each axis's brake; 1 releases it."""
    brake_feedback_inputs: dict[Name, Address]
    """Discrete input of each axis's brake; 1 is open."""
    hold_to_run_input: Address
    """Discrete input of the hold-to-run button; 1 is pressed."""
    hold_to_run_released_input: Address | None = None
    """Discrete input of the button's second, opposite contact; 1 is released. Motion needs both to say pressed, so a stuck contact does not
    keep the machine moving."""
    door_input: Address
    """Discrete input of the door; 1 is closed."""
    temperature_registers: Annotated[dict[Name, Address], Field(default_factory=dict)]
    """Input register of each axis's temperature, int16 in 0.1 °C."""
    loop_back: LoopBackTable | None = None
    """Output that is wired to an input. Without one, inputs that are frozen show only when a brake should move."""
    watchdog: WatchdogTable | None = None
    """Output watchdog of the device. Without one only the loop and the poller close brakes."""


class BusTable(Table):
    """Table `[bus]`: everything on the wires."""

    bitrate_bit_s: Literal[10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000]
    """A bit rate of CiA 301 [bit/s]."""
    sync_cob_id: CobId = 0x080
    """Identifier of SYNC."""
    sync_producer: Name | None = None
    """The device that sends SYNC at the sample rate, a motion controller say, by any name; it is none of `nodes`. The bench then sends none
    and follows. It refuses a wrong rate, and stops the run when SYNC stays away for more than `overrun_ticks` or a second producer sends
    it. Without this the bench sends SYNC."""
    master_node_id: NodeId
    """Node number of the bench itself."""
    master_heartbeat: Seconds
    """Period of the bench's heartbeat."""
    answer_timeout: Seconds
    """How long the loop waits after a SYNC for the last answer; shorter than the sample period."""
    answers: Literal["punctual", "awaited"] = "punctual"
    """`"punctual"`: an answer that comes later is missing from its row. `"awaited"`: the loop waits for it, for emulators whose host
    keeps no time."""
    nodes: Annotated[dict[Name, NodeTable], Field(min_length=1)]
    """The devices, by name."""
    homing: dict[Name, HomingTable]
    """How each axis is homed."""
    imu: ImuPortTable | None = None
    """Port of the IMU."""
    io: IoTable | None = None
    """Inputs and outputs."""
