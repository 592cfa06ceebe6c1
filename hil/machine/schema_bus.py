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
    """[[bus.nodes.NAME.tpdo]] or rpdo."""

    number: Annotated[Whole, Field(ge=1, le=512)]
    cob_id: CobId
    transmission_type: Annotated[Whole, Field(ge=0, le=255)]
    map: Annotated[tuple[Text, ...], Field(min_length=1, max_length=64)]


class WriteTable(Table):
    """[[bus.nodes.NAME.write]]: a further object, written and read back."""

    index: Annotated[Whole, Field(ge=0x1000, le=0xFFFF)]
    subindex: Annotated[Whole, Field(ge=0, le=255)] = 0
    value: Annotated[Whole, Field(ge=-(2**31), le=0xFFFF_FFFF)]


class NodeTable(Table):
    """[bus.nodes.NAME]: one CANopen device."""

    role: Literal["drive", "encoder"]
    axis: Name
    node_id: NodeId
    eds: Annotated[Text, Field(min_length=1)]
    vendor_id: Unsigned32 | None = None
    product_code: Unsigned32 | None = None
    revision_number: Unsigned32 | None = None
    serial_number: Unsigned32 | None = None
    heartbeat: Seconds
    boot_timeout: Seconds
    zero_counts: Annotated[Whole, Field(ge=0, le=0xFFFF_FFFF)] = 0
    tpdo: tuple[PdoTable, ...] = ()
    rpdo: tuple[PdoTable, ...] = ()
    write: tuple[WriteTable, ...] = ()


class HomingTable(Table):
    """[bus.homing.AXIS]: how an axis finds its zero, and what is checked on the way."""

    method: Annotated[Whole, Field(ge=-128, le=37)]
    speed: Annotated[Positive, Quantity("angular_speed", "speed")]
    acceleration: Annotated[Positive, Quantity("angular_acceleration", "acceleration")]
    timeout: Seconds
    agreement_tolerance: Annotated[Positive, Quantity("angle", "length")]
    direction_check_effort: Annotated[Positive, Quantity(*EFFORT_DIMENSIONS)]
    direction_check_travel: Annotated[Positive, Quantity("angle", "length")]
    direction_check_timeout: Seconds
    travel_limit: Annotated[Positive | None, Quantity("angle", "length")] = None


class ImuPortTable(Table):
    """[bus.imu]: the serial IMU."""

    sensor: Name
    device: Text = ""
    baud: Annotated[Whole, Field(ge=1200, le=4_000_000)]
    triggered_by_sync: Flag
    rate: Annotated[Number, Field(gt=0, le=2000), Quantity("frequency")]


class IoTable(Table):
    """[bus.io]: Modbus inputs and outputs."""

    url: Text = ""
    unit_id: Annotated[Whole, Field(ge=1, le=247)]
    poll_period: Seconds
    stale_after: Seconds
    brake_coils: dict[Name, Address]
    brake_feedback_inputs: dict[Name, Address]
    hold_to_run_input: Address
    door_input: Address
    temperature_registers: Annotated[dict[Name, Address], Field(default_factory=dict)]


class BusTable(Table):
    """[bus]: everything on the wires."""

    bitrate_bit_s: Literal[10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000]
    sync_cob_id: CobId = 0x080
    master_node_id: NodeId
    master_heartbeat: Seconds
    answer_timeout: Seconds
    answers: Literal["punctual", "awaited"] = "punctual"
    nodes: Annotated[dict[Name, NodeTable], Field(min_length=1)]
    homing: dict[Name, HomingTable]
    imu: ImuPortTable | None = None
    io: IoTable | None = None
