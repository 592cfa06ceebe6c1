"""The bus's settings from the file's [bus] tables: nodes, PDO maps, scalings, homing, serial IMU, Modbus."""

from __future__ import annotations

import math
from pathlib import Path

from drivers.canopen.can_imu import COUNTER, FORCE, RATE
from drivers.canopen.cia402 import HOMING_AT_PRESENT_POSITION, NO_HOMING
from drivers.canopen.objects import MAPPABLE
from drivers.settings import AxisScaling, BusSettings, HomingSettings, Identity, ImuPort, IoMap, IoWatchdog, MotionLimits, Node, Pdo
from hil.machine.build import POSITION_UNITS, joint_of, require_effort_unit, require_kind, require_known
from hil.machine.build_control import furthest_target
from hil.machine.messages import ComplaintError
from hil.machine.schema import MachineTable
from hil.machine.schema_bus import BusTable, IoTable, NodeTable, PdoTable
from virtual_bus.settings import PlantSettings

Where = tuple[str | int, ...]

EDS_FOLDER = Path(__file__).resolve().parents[2] / "drivers" / "canopen" / "eds_files"

# CiA 301 table 38 and 7.3.5: identifiers that belong to no PDO
_RESERVED_COB_IDS: tuple[tuple[int, int, str], ...] = (
    (0x000, 0x000, "NMT"),
    (0x001, 0x07F, "reserved by CiA 301"),
    (0x101, 0x180, "reserved by CiA 301"),
    (0x081, 0x0FF, "EMCY"),
    (0x100, 0x100, "TIME"),
    (0x581, 0x5FF, "SDO answers"),
    (0x601, 0x67F, "SDO requests"),
    (0x6E0, 0x6FF, "reserved by CiA 301"),
    (0x701, 0x77F, "heartbeats"),
    (0x780, 0x7FF, "reserved by CiA 301"),
)

# what the loop cannot do without: role -> direction -> objects
_NEEDED: dict[str, dict[str, tuple[str, ...]]] = {
    "drive": {"tpdo": ("statusword", "position_actual_value"), "rpdo": ("controlword",)},
    "encoder": {"tpdo": ("position_value",)},
    "imu": {"tpdo": tuple(name for name, (index, *_) in MAPPABLE.items() if index in (FORCE, RATE, COUNTER))},
}
# and what a drive needs in its RPDOs for what the loop commands; the effort has either object
_COMMANDED = {
    "torque": (),
    "velocity": ("target_velocity", "torque_offset"),
    "position": ("target_position", "torque_offset"),
    "profile_velocity": ("target_velocity",),
    "profile_position": ("target_position",),
}
_A = {"drive": "a drive", "encoder": "an encoder", "imu": "an IMU"}
_EFFORT = ("target_torque", "torque_offset")


def build_bus(table: MachineTable, plant: PlantSettings, folder: Path | None) -> BusSettings | None:
    """Build the whole bus; None for a machine without one. EDS files are taken from `folder`, else from the shipped ones."""
    bus = table.bus
    if bus is None:
        return None
    where: Where = ("bus",)
    if bus.answers == "punctual" and bus.answer_timeout >= plant.sample_period_s:
        right = f'must be shorter than the sample period of {plant.sample_period_s:.6g} s (unless answers = "awaited", for emulators)'
        raise ComplaintError((*where, bus.key("answer_timeout")), right)
    if bus.sync_producer in bus.nodes:
        right = f"{bus.sync_producer} is one of the nodes, which the bench configures; name a device that sends SYNC by itself"
        raise ComplaintError((*where, "sync_producer"), right)
    if bus.sync_producer and bus.answers == "awaited":
        raise ComplaintError((*where, bus.key("answers")), 'another device\'s next SYNC waits for no answer: must be "punctual"')
    if bus.sync_producer and table.timing.overrun == "wait":
        raise ComplaintError((*where, "sync_producer"), 'another device\'s ticks do not wait: timing.overrun must be "skip"')
    _check_cob_ids(bus)
    _check_nodes(bus, table)
    for axis in table.drives:
        if not table.limits.get(axis):
            raise ComplaintError(("limits", axis), "is missing; a machine on a bus needs limits for every axis")
        if axis not in table.controller and not table.drives[axis].mode.endswith("position"):
            raise ComplaintError(("controller", axis), "is missing; a machine on a bus needs a controller for every axis")
    return BusSettings(
        bitrate_bit_s=bus.bitrate_bit_s,
        sync_cob_id=bus.sync_cob_id,
        sync_period_s=plant.sample_period_s,
        master_node_id=bus.master_node_id,
        master_heartbeat_period_s=bus.master_heartbeat,
        answer_timeout_s=bus.answer_timeout,
        nodes=tuple(_node(name, node, folder) for name, node in bus.nodes.items()),
        scalings=tuple(_scaling(axis, table, plant) for axis in table.drives),
        homings=tuple(_homing(axis, table, plant) for axis in table.drives),
        motions=tuple(_motion(axis, table) for axis in table.drives),
        imu=_imu_port(bus, table),
        io=_io(bus, table),
        sync_producer=bus.sync_producer or "",
        overrun_ticks=table.timing.overrun_ticks,
    )


def _check_nodes(bus: BusTable, table: MachineTable) -> None:
    taken: dict[int, str] = {bus.master_node_id: "the bench (master_node_id)"}
    served: dict[tuple[str, str], str] = {}
    for name, node in bus.nodes.items():
        where: Where = ("bus", "nodes", name)
        require_known(node.axis, table.drives, (*where, "axis"), "axis")
        if node.node_id in taken:
            raise ComplaintError((*where, "node_id"), f"already the id of {taken[node.node_id]}; ids must differ")
        taken[node.node_id] = name
        if (node.role, node.axis) in served:
            raise ComplaintError((*where, "axis"), f"already has the {node.role} {served[node.role, node.axis]}")
        served[node.role, node.axis] = name
        if node.role == "encoder" and f"link_position_{node.axis}" not in table.sensors:
            raise ComplaintError((*where, "axis"), f"has no link encoder; add [sensors.link_position_{node.axis}]")
        _check_sensor(name, node, bus, table)
        for direction, objects in _NEEDED[node.role].items():
            for needed in objects:
                if not _maps(node, direction, needed):
                    raise ComplaintError(
                        (*where, direction), f"{needed} is mapped nowhere; {_A[node.role]} needs it in a {direction.upper()}"
                    )
        if node.role == "drive":
            mode = table.drives[node.axis].mode
            for needed in _COMMANDED[mode]:
                if not _maps(node, "rpdo", needed):
                    raise ComplaintError((*where, "rpdo"), f"{needed} is mapped nowhere; a drive in {mode} mode needs it in an RPDO")
            efforts = sum(_maps(node, "rpdo", effort) for effort in _EFFORT)
            if efforts > 1 or (not efforts and not mode.startswith("profile")):
                raise ComplaintError((*where, "rpdo"), f"a drive needs one of {' and '.join(_EFFORT)} in an RPDO, for the effort")
    for axis in table.drives:
        if ("drive", axis) not in served:
            raise ComplaintError(("bus", "nodes"), f'no drive for axis {axis}; add a node with role = "drive", axis = "{axis}"')


def _maps(node: NodeTable, direction: str, name: str) -> bool:
    entries = [entry for pdo in getattr(node, direction) for entry in pdo.map]
    return name in entries or any(_numbers(entry) == MAPPABLE[name] for entry in entries)


def _check_cob_ids(bus: BusTable) -> None:
    taken = {bus.sync_cob_id: "SYNC"}
    for name, node in bus.nodes.items():
        for direction in ("tpdo", "rpdo"):
            numbers: set[int] = set()
            for position, pdo in enumerate(getattr(node, direction)):
                where: Where = ("bus", "nodes", name, direction, position)
                if pdo.number in numbers:
                    raise ComplaintError((*where, "number"), f"{name} has this {direction.upper()} twice")
                numbers.add(pdo.number)
                for first, last, owner in _RESERVED_COB_IDS:
                    if first <= pdo.cob_id <= last:
                        raise ComplaintError((*where, "cob_id"), f"0x{pdo.cob_id:03X} belongs to {owner}; PDOs use 0x181 to 0x57F")
                if pdo.cob_id in taken:
                    raise ComplaintError(
                        (*where, "cob_id"), f"0x{pdo.cob_id:03X} already belongs to {taken[pdo.cob_id]}; COB-IDs must differ"
                    )
                taken[pdo.cob_id] = f"{name} {direction.upper()}{pdo.number}"
                _check_map(pdo, where)


def _numbers(entry: str) -> tuple[int, int, int] | None:
    """(index, subindex, bits) of a map entry; None when it cannot be read."""
    if entry in MAPPABLE:
        return MAPPABLE[entry]
    parts = entry.split(":")
    if len(parts) != 3:
        return None
    try:
        index, subindex, bits = int(parts[0], 16), int(parts[1], 16), int(parts[2])
    except ValueError:
        return None
    return (index, subindex, bits) if 1 <= index <= 0xFFFF and 0 <= subindex <= 0xFF and 1 <= bits <= 64 else None


def _check_map(pdo: PdoTable, where: Where) -> None:
    total = 0
    for position, entry in enumerate(pdo.map):
        numbers = _numbers(entry)
        if numbers is None:
            right = 'write a name such as "statusword" or index:subindex:bits such as "0x6064:00:32"'
            raise ComplaintError((*where, "map", position), f"no such object; {right}")
        total += numbers[2]
    if total > 64:
        raise ComplaintError((*where, "map"), f"holds {total / 8:g} bytes; a PDO holds 8")
    if total % 8:
        raise ComplaintError((*where, "map"), f"holds {total} bits; a PDO holds whole bytes")


def _check_sensor(name: str, node: NodeTable, bus: BusTable, table: MachineTable) -> None:
    """Complain unless an IMU on the bus, and nothing else, names a sensor that is on no other wire."""
    where: Where = ("bus", "nodes", name, "sensor")
    if node.role != "imu":
        if node.sensor is not None:
            raise ComplaintError(where, f"is for an IMU; this node is a {node.role}: leave it out")
        return
    imus = [channel for channel, sensor in table.sensors.items() if sensor.type == "imu"]
    if node.sensor is None:
        raise ComplaintError(where, f"is missing; there is {', '.join(imus) or 'no IMU in [sensors]'}")
    require_known(node.sensor, imus, where, "IMU")
    if bus.imu is not None and node.sensor == bus.imu.sensor:
        raise ComplaintError(where, "is on the serial line ([bus.imu]) already; name another")
    others = [other for other, each in bus.nodes.items() if each.role == "imu" and other != name]
    if others:
        raise ComplaintError(("bus", "nodes", name, "role"), f"there is the IMU {others[0]} already; one on the bus is supported")


def _node(name: str, node: NodeTable, folder: Path | None) -> Node:
    beside = None if folder is None else folder / node.eds
    return Node(
        name=name,
        role=node.role,
        axis=node.axis,
        node_id=node.node_id,
        eds=beside if beside is not None and beside.is_file() else EDS_FOLDER / node.eds,
        identity=Identity(node.vendor_id, node.product_code, node.revision_number, node.serial_number),
        tpdos=tuple(_pdo(pdo) for pdo in node.tpdo),
        rpdos=tuple(_pdo(pdo) for pdo in node.rpdo),
        heartbeat_period_s=node.heartbeat,
        boot_timeout_s=node.boot_timeout,
        writes=tuple((write.index, write.subindex, write.value) for write in node.write),
        sensor=node.sensor or "",
        stopped_by=node.stopped_by,
        foreign_sdo=node.foreign_sdo,
    )


def _pdo(pdo: PdoTable) -> Pdo:
    entries = tuple(numbers for entry in pdo.map if (numbers := _numbers(entry)) is not None)
    return Pdo(pdo.number, pdo.cob_id, pdo.transmission_type, entries)


def _scaling(axis: str, table: MachineTable, plant: PlantSettings) -> AxisScaling:
    index = list(table.drives).index(axis)
    drive, table_drive = plant.drives[index], table.drives[axis]
    resolution = {encoder.channel: encoder.resolution for encoder in plant.encoders}
    zero = [node.zero_counts for node in table.bus.nodes.values() if (node.role, node.axis) == ("encoder", axis)] if table.bus else []
    if table_drive.rated_current is None and table_drive.rated_effort is None:
        raise ComplaintError(
            ("drives", axis), f"needs rated_current_A (or rated_effort_{drive.unit}): targets on the wire are per mille of it"
        )
    if resolution[f"position_{axis}"] == 0.0:
        raise ComplaintError(("sensors", f"position_{axis}"), "needs a resolution: positions on the wire are whole counts")
    return AxisScaling(
        axis=axis,
        position_resolution=resolution[f"position_{axis}"],
        link_resolution=resolution.get(f"link_position_{axis}", 0.0) if zero else 0.0,
        link_zero_counts=zero[0] if zero else 0,
        sign=table_drive.direction,
        mode=table_drive.mode,
        rated=drive.rated,
        limit=drive.limit,
        rated_torque_mNm=max(1, round(drive.rated * drive.constant * 1000.0)),
        rated_current_mA=max(1, round(drive.rated * 1000.0)),
        position_unit=POSITION_UNITS[joint_of(axis, table, plant.tree).kind],
        counts_per_motor_turn=2.0 * math.pi / (resolution[f"position_{axis}"] * table_drive.ratio),
        velocity_unit=table_drive.velocity_unit or "",
        acceleration_unit=table_drive.acceleration_unit or "",
    )


def _homing(axis: str, table: MachineTable, plant: PlantSettings) -> HomingSettings:
    assert table.bus is not None
    for name in table.bus.homing:
        require_known(name, table.drives, ("bus", "homing", name), "axis")
    homing = table.bus.homing.get(axis)
    where: Where = ("bus", "homing", axis)
    if homing is None:
        raise ComplaintError(where, "is missing; every axis says how it finds its zero")
    for field in ("speed", "acceleration", "agreement_tolerance", "direction_check_travel", "travel_limit"):
        require_kind(homing, field, joint_of(axis, table, plant.tree).kind, where)
    require_effort_unit(homing, "direction_check_effort", table.drives[axis].effort_unit, where)
    if homing.direction_check_effort > table.drives[axis].limit:
        raise ComplaintError((*where, homing.key("direction_check_effort")), "is more than the drive's limit")
    if homing.method in (*HOMING_AT_PRESENT_POSITION, NO_HOMING) and _scaling(axis, table, plant).link_resolution == 0.0:
        right = "takes the present position as zero; add a link encoder or choose a method that finds a reference"
        raise ComplaintError((*where, "method"), right)
    return HomingSettings(
        axis=axis,
        method=homing.method,
        speed=homing.speed,
        acceleration=homing.acceleration,
        timeout_s=homing.timeout,
        agreement_tolerance=homing.agreement_tolerance,
        direction_check_effort=homing.direction_check_effort,
        direction_check_travel=homing.direction_check_travel,
        direction_check_timeout_s=homing.direction_check_timeout,
        travel_limit=table.limits[axis].range[1] - table.limits[axis].range[0] if homing.travel_limit is None else homing.travel_limit,
    )


def _motion(axis: str, table: MachineTable) -> MotionLimits:
    limits, loops = table.limits[axis], table.drives[axis].loops
    furthest = limits.tracking_error if loops is None else furthest_target(limits.speed, limits.tracking_error, loops.position_gain)
    return MotionLimits(
        axis,
        *limits.range,
        limits.speed,
        limits.tracking_error,
        table.timing.stale_ticks,
        limits.acceleration,
        limits.quick_stop,
        furthest,
    )


def _imu_port(bus: BusTable, table: MachineTable) -> ImuPort | None:
    if bus.imu is None:
        return None
    imus = [name for name, sensor in table.sensors.items() if sensor.type == "imu"]
    require_known(bus.imu.sensor, imus, ("bus", "imu", "sensor"), "IMU")
    if bus.imu.sensor != imus[0]:
        raise ComplaintError(("bus", "imu", "sensor"), f"the serial line's IMU is the first of [sensors]; that is {imus[0]}")
    return ImuPort(bus.imu.sensor, bus.imu.device, bus.imu.baud, bus.imu.triggered_by_sync, bus.imu.rate)


def _io(bus: BusTable, table: MachineTable) -> IoMap | None:
    io = bus.io
    if io is None:
        return None
    for field in ("brake_coils", "brake_feedback_inputs", "temperature_registers"):
        addresses: dict[str, int] = getattr(io, field)
        for axis in addresses:
            require_known(axis, table.drives, ("bus", "io", field, axis), "axis")
        if len(set(addresses.values())) < len(addresses):
            raise ComplaintError(("bus", "io", field), "two axes share an address; addresses must differ")
    inputs = [*io.brake_feedback_inputs.values(), io.hold_to_run_input, io.door_input]
    inputs += [] if io.hold_to_run_released_input is None else [io.hold_to_run_released_input]
    inputs += [] if io.loop_back is None else [io.loop_back.input]
    if io.loop_back is not None and io.loop_back.coil in io.brake_coils.values():
        raise ComplaintError(("bus", "io", "loop_back", "coil"), "is a brake's; wire an output of its own")
    if len(set(inputs)) < len(inputs):
        names = "brake_feedback_inputs, hold_to_run_input, hold_to_run_released_input, door_input and loop_back.input"
        raise ComplaintError(("bus", "io"), f"two discrete inputs share an address; {names} must differ")
    for axis in io.temperature_registers:
        if f"temperature_{axis}" not in table.sensors:
            raise ComplaintError(("bus", "io", "temperature_registers", axis), f"no such thermometer; add [sensors.temperature_{axis}]")
    return IoMap(
        url=io.url,
        unit_id=io.unit_id,
        poll_period_s=io.poll_period,
        stale_after_s=io.stale_after,
        brake_coils=io.brake_coils,
        brake_feedback_inputs=io.brake_feedback_inputs,
        hold_to_run_input=io.hold_to_run_input,
        door_input=io.door_input,
        temperature_registers=io.temperature_registers,
        watchdog=_watchdog(io),
        hold_to_run_released_input=io.hold_to_run_released_input,
        loop_back=None if io.loop_back is None else (io.loop_back.coil, io.loop_back.input),
    )


REFRESH_POLLS = 2
"""Polls that a refresh takes: one brings the device's word, the next the word that follows."""
WATCHDOG_AT_MOST_S = 1.0
"""Longest time of an output watchdog: a heavy arm falls by half a turn in it."""


def _watchdog(io: IoTable) -> IoWatchdog | None:
    if io.watchdog is None:
        return None
    least_s = 2 * REFRESH_POLLS * io.poll_period
    if not least_s <= io.watchdog.timeout <= WATCHDOG_AT_MOST_S:
        words = f"{io.watchdog.timeout:g} s; two refreshes take {least_s:g} s at this poll period, {WATCHDOG_AT_MOST_S:g} s is the most"
        raise ComplaintError(("bus", "io", "watchdog", "timeout"), words)
    return IoWatchdog(io.watchdog.holding_register, io.watchdog.timeout)
