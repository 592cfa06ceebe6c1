"""The emulated machine of a machine file: its physics, and every device on its bus and lines."""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can
import numpy as np

from drivers.bus_url import open_bus
from drivers.canopen.eds import own_node_id
from drivers.errors import BusUnavailableError, ProtocolError
from drivers.modbus.transport import parse_io_url
from drivers.serial.stream import SerialStream
from hil.emulated.card import EmulatorCard, published
from hil.emulated.truth import TruthLog
from hil.errors import UnusableInputError
from hil.machine import Machine
from hil.processes.real_time import real_time
from virtual_bus.canopen.bare import BareMachine
from virtual_bus.canopen.lss import UNCONFIGURED
from virtual_bus.emulator import Ports, run_device, run_emulator
from virtual_bus.faults.binding import inject
from virtual_bus.faults.devices import FaultyBrakes, FaultyImu, FaultyIo
from virtual_bus.faults.fault import FaultSetting
from virtual_bus.faults.machine import FaultyMachine
from virtual_bus.faults.motion_log import MotionLog
from virtual_bus.idle_time import SILENCE_S
from virtual_bus.machine import EmulatedMachine
from virtual_bus.modbus.io_device import EmulatedIo, IoLayout
from virtual_bus.physics import Physics
from virtual_bus.plant.linearise import inertia_matrix
from virtual_bus.quirks.quirk import QuirkSetting
from virtual_bus.quirks.registry import put_on
from virtual_bus.serial.pty import Pty
from virtual_bus.serial.xsens_imu import EmulatedImu
from virtual_bus.settings import EmulatedBus, EmulatedCanImu, EmulatedDrive, EmulatedEncoder

if TYPE_CHECKING:
    from hil.emulated.pose_board import PoseBoard

OWN_LOOP_BANDWIDTH_Hz = 2.0
"""Bandwidth of the drives' own velocity loop: a quarter of the slowest mode of such a structure, 8 Hz."""
INTEGRAL_CORNER_SHARE = 1.0 / 4.0
"""Corner of the velocity loop's integral action over its bandwidth: it costs 14 degrees of phase where the loop crosses over."""

LONGEST_SILENCE_S = 0.5
"""Where heartbeats are slow, longest pause of a bench before the machine's time continues without it; each real wait takes this much
longer."""

STANDARD_BITRATE = 1_000_000
PTY_BAUD = 115_200  # a pseudo terminal accepts any; the bench is told this one


def build_emulated(
    machine: Machine,
    pose: np.ndarray | None = None,
    *,
    seed: int = 0,
    noise: bool = True,
    truth: TruthLog | None = None,
    board: PoseBoard | None = None,
    faults: Sequence[FaultSetting] = (),
    motion: MotionLog | None = None,
    quirks: Sequence[QuirkSetting] = (),
    by_the_wall: bool = False,
) -> EmulatedMachine:
    """Build the whole machine, placed at `pose` (n_axes,), not yet powered on; the panel's process reads the `board`.

    `by_the_wall`: without SYNCs its time is that of the wall. With `faults`, `quirks`, or a log for its true `motion`, it is a
    `FaultyMachine`.

    Raises
    ------
    UnusableInputError
        The machine file has no bus.
    """
    if machine.bus is None:
        raise UnusableInputError(f"{machine.name}: its file has no [bus]; there is nothing to emulate on a wire")
    physics = Physics(machine.plant, seed, noise)
    physics.advance()  # compiles everything before a caller waits for an answer; `place` undoes the step
    io_map = machine.bus.io
    layout = None
    if io_map is not None:
        layout = IoLayout(
            io_map.unit_id,
            io_map.brake_coils,
            io_map.brake_feedback_inputs,
            io_map.hold_to_run_input,
            io_map.door_input,
            io_map.temperature_registers,
            None if io_map.watchdog is None else io_map.watchdog.register,
            0.0 if io_map.watchdog is None else io_map.watchdog.timeout_s,
            io_map.hold_to_run_released_input,
            io_map.loop_back,
        )
    geometry = machine.geometry

    def witness(time_s: float) -> None:
        true = physics.truth()
        if truth is not None:
            truth.add(time_s, true)
        if board is not None and geometry is not None:
            board.put(emulated.syncs, time_s, true[f"pose_{geometry.source_body}"], true[f"pose_{geometry.detector_body}"])

    devices = replace(emulated_bus(machine, physics), by_the_wall=by_the_wall)
    period_s, has_imu, brake_delay_s = machine.plant.sample_period_s, machine.bus.imu is not None, max(machine.brake_delay_s)
    seen = None if truth is None and board is None else witness
    emulated: EmulatedMachine
    if faults or quirks or motion is not None:
        brakes = FaultyBrakes(physics)
        faulty_io = FaultyIo(layout, machine.axes, brakes, brake_delay_s) if layout is not None else None
        faulty_imu = FaultyImu() if has_imu else None
        emulated = FaultyMachine(
            physics, devices, period_s, brakes=brakes, imu=faulty_imu, io=faulty_io, witness=seen, seed=seed, log=motion
        )
        inject(emulated, faults)
        put_on(emulated, quirks)
    else:
        io = EmulatedIo(layout, machine.axes, physics.set_brakes, brake_delay_s) if layout is not None else None
        emulated = EmulatedMachine(physics, devices, period_s, imu=EmulatedImu() if has_imu else None, io=io, witness=seen)
    emulated.place(np.zeros(len(machine.axes)) if pose is None else pose)
    return emulated


def with_data_sheet(machine: Machine, device: str, eds: Path) -> Machine:
    """Return the machine whose drive or encoder of an axis, `device` = "drive:AXIS" or "encoder:AXIS", has this data sheet.

    Raises
    ------
    UnusableInputError
        The machine has no such device, or there is no such file.
    """
    nodes = machine.bus.nodes if machine.bus is not None else ()
    there = [f"{node.role}:{node.axis}" for node in nodes]
    if machine.bus is None or device not in there:
        right = f"it has {', '.join(there)}" if there else "its file has no [bus]"
        raise UnusableInputError(f"--as {device}: {machine.name} has no such device; {right}")
    if not eds.is_file():
        raise UnusableInputError(f"{eds}: no such EDS file")
    changed = tuple(replace(node, eds=eds) if device == name else node for name, node in zip(there, nodes, strict=True))
    return replace(machine, bus=replace(machine.bus, nodes=changed))


def emulated_bus(machine: Machine, physics: Physics) -> EmulatedBus:
    """Return the CANopen devices that the machine file describes."""
    bus = machine.bus
    assert bus is not None
    gains = _own_loops(machine, physics)
    drives, encoders, imus = [], [], []
    for node in bus.nodes:
        if node.role == "imu":
            number = [imu.name for imu in machine.plant.imus].index(node.sensor)
            imus.append(EmulatedCanImu(node.name, node.node_id, node.eds, number))
            continue
        scaling = bus.scalings[machine.axis_index(node.axis)]
        if node.role == "drive":
            limit = machine.limits[machine.axis_index(node.axis)]
            ends = (limit.lower, limit.upper)[:: scaling.sign]  # limit switches, in the drive's own direction
            drives.append(
                EmulatedDrive(
                    node.name,
                    node.axis,
                    node.node_id,
                    node.eds,
                    scaling.rated,
                    scaling.rated_current_mA,
                    scaling.rated_torque_mNm,
                    scaling.limit,
                    scaling.position_resolution,
                    counts_per_turn=_counts_per_motor_turn(machine, node.axis, scaling.position_resolution),
                    sign=scaling.sign,
                    negative_switch=ends[0],
                    positive_switch=ends[1],
                    velocity_unit=scaling.velocity_unit,
                    acceleration_unit=scaling.acceleration_unit,
                    **gains[node.axis],
                )
            )
        else:
            turn = 2.0 * math.pi if machine.units[machine.axis_index(node.axis)].position == "rad" else 1.0
            encoders.append(
                EmulatedEncoder(
                    node.name,
                    node.axis,
                    node.node_id,
                    node.eds,
                    counts_per_turn=round(turn / scaling.link_resolution),
                    zero_counts=scaling.link_zero_counts,
                )
            )
    silence_s = min(LONGEST_SILENCE_S, bus.master_heartbeat_period_s, *(node.heartbeat_period_s for node in bus.nodes))
    return EmulatedBus(
        bus.sync_cob_id, tuple(drives), tuple(encoders), bool(bus.sync_producer), max(silence_s, SILENCE_S), imus=tuple(imus)
    )


def _counts_per_motor_turn(machine: Machine, axis: str, resolution: float) -> int:
    drive = machine.plant.drives[machine.axis_index(axis)]
    turn = 2.0 * math.pi if machine.units[machine.axis_index(axis)].position == "rad" else 1.0
    return max(1, round(turn / (resolution * drive.ratio)))


def _own_loops(machine: Machine, physics: Physics) -> dict[str, dict[str, Any]]:
    """Return each axis's own loops as the machine file has them, by their names in `EmulatedDrive`, else loops that suit the joint.

    Then the velocity gain [drive's unit per rad/s or m/s] is the joint's inertia at pose zero times the bandwidth, over the effort of one
    unit. The position gain is left out: `EmulatedDrive` derives it from the other two, and says why.
    """
    inertia = inertia_matrix(physics.plant, physics.model, np.zeros(physics.plant.joints))
    joints = physics.plant.joint_of_axis()
    bandwidth_rad_s = 2.0 * math.pi * OWN_LOOP_BANDWIDTH_Hz
    found: dict[str, dict[str, Any]] = {}
    for drive, loops in zip(machine.plant.drives, machine.drive_loops, strict=True):
        if loops is not None:
            sections = () if loops.torque_sections is None else tuple(map(tuple, loops.torque_sections.tolist()))
            found[drive.axis] = {**vars(loops), "torque_sections": sections}
            continue
        joint = joints[drive.axis]
        gain = bandwidth_rad_s * float(inertia[joint, joint]) / (drive.constant * drive.ratio)
        found[drive.axis] = {"velocity_gain": gain, "velocity_integral_gain": gain * bandwidth_rad_s * INTEGRAL_CORNER_SHARE}
    return found


def emulate_machine(
    machine: Machine,
    bus_url: str,
    pose: Mapping[str, float],
    *,
    seed: int = 0,
    noise: bool = True,
    truth: Path | None = None,
    punctual: bool = True,
    io_rtu: str = "",
    panel: str = "",
    faults: Sequence[FaultSetting] = (),
    quirks: Sequence[QuirkSetting] = (),
    by_the_wall: bool = False,
    on_ready: Callable[[dict[str, object]], None],
) -> None:
    """Emulate a machine on a bus, wall clock, until SIGTERM or SIGINT.

    Parameters
    ----------
    io_rtu : str
        Serve the I/O over Modbus RTU too: on a pseudo terminal ("pty") or a serial port ("DEVICE@BAUD").
    panel : str
        Serve an X-ray panel too, with this scene or marker plate in the beam.
    faults : sequence of FaultSetting
        What goes wrong, and when.
    quirks : sequence of QuirkSetting
        How its drives bend the standard.
    by_the_wall : bool
        While no SYNC comes, its devices' time is that of the wall; else it waits for who may be about to speak.
    on_ready : callable
        Called once, when all ports are open, with a description of the machine and the ports of IMU and I/O.

    Raises
    ------
    UnusableInputError
        The machine file has no bus, or a data sheet in it does not fit its device.
    DriverError
        The bus or the serial port cannot be opened.
    EmulatorError
        A port cannot be served, or the bus was lost.
    """
    with ExitStack() as stack:
        bus = stack.enter_context(opened_bus(bus_url, machine.bus.bitrate_bit_s if machine.bus is not None else STANDARD_BITRATE))
        log = stack.enter_context(closing(TruthLog(truth, machine.plant.tree.joints))) if truth is not None else None
        line, baud = _io_line(io_rtu, machine, stack) if io_rtu else (None, 0)
        start = np.array([pose.get(axis, 0.0) for axis in machine.axes])
        board, panel_url = None, ""
        if panel:
            from hil.emulated.network_panel import panel_beside
            from hil.emulated.pose_board import PoseBoard

            board = PoseBoard(multiprocessing.get_context("spawn"))
            panel_url = stack.enter_context(panel_beside(machine, board, panel))
        try:
            emulated = build_emulated(
                machine, start, seed=seed, noise=noise, truth=log, board=board, faults=faults, quirks=quirks, by_the_wall=by_the_wall
            )
        except ProtocolError as error:
            raise UnusableInputError(str(error)) from None  # a data sheet that does not fit its device

        def ready(ports: Ports) -> None:
            # The bench takes the TCP port: the kernel passes data of a pseudo terminal on in a worker of ordinary priority, for which a
            # bench of real-time priority would wait.
            stack.enter_context(published(EmulatorCard(bus_url, os.getpid(), ports.imu_url, ports.io_url, panel_url, panel)))
            imu = ports.imu_device or ports.imu_url
            ready_now: dict[str, object] = {"ready": machine.name, "bus": bus_url, "imu": imu, "imu_tcp": ports.imu_url, "io": ports.io_url}
            more = {"io_rtu": f"rtu:{ports.io_line}@{baud}" if ports.io_line else "", "panel": panel_url}
            on_ready(ready_now | {name: url for name, url in more.items() if url})

        with real_time(wanted=punctual):  # answers as punctual as those of hardware, where the system grants it
            run_emulator(bus, emulated, ready, io_line=line, punctual=punctual)


class _SerialPort(SerialStream):
    """A serial port with the path that the bench uses."""

    @property
    def path(self) -> str:
        """Path of the port."""
        return self.device


def _io_line(text: str, machine: Machine, stack: ExitStack) -> tuple[Pty | _SerialPort, int]:
    """Return the line on which Modbus RTU is served, closed with `stack`, and its baud rate."""
    if machine.bus is None or machine.bus.io is None:
        raise UnusableInputError(f"--io-rtu {text}: {machine.name} has no [bus.io]; leave it out")
    if text == "pty":
        return stack.enter_context(closing(Pty())), PTY_BAUD
    try:
        line = parse_io_url(f"rtu:{text}")
    except BusUnavailableError:
        words = "write pty, or DEVICE@BAUD, for example /dev/ttyUSB1@115200 or /dev/ttyUSB1@19200,8N1"
        raise UnusableInputError(f"--io-rtu {text}: {words}") from None
    return stack.enter_context(closing(_SerialPort(line.place, line.number, line.parity, line.stop_bits))), line.number


def emulate_eds(
    eds: Path, node_id: int | None, bus_url: str, on_ready: Callable[[dict[str, object]], None], memory: Path | None = None
) -> None:
    """Emulate one bare CiA 301 device of an EDS on a bus until SIGTERM or SIGINT.

    The file of its `memory` keeps what 1010h and LSS store. Without a node id it has that of a DCF, else 1; 255 waits for another over LSS.

    Raises
    ------
    UnusableInputError
        The node id or the EDS cannot be used.
    DriverError
        The bus cannot be opened.
    EmulatorError
        The memory is none of a device, or the bus was lost.
    """
    if node_id is None:
        try:
            node_id = own_node_id(eds) or 1
        except ProtocolError as error:
            raise UnusableInputError(str(error)) from None
    if not (1 <= node_id <= 127 or node_id == UNCONFIGURED):
        raise UnusableInputError(f"--node {node_id}: must be 1 to 127, or 255 for a device that waits for its node id over LSS")
    try:
        device = BareMachine(eds, node_id, memory)
    except ProtocolError as error:
        raise UnusableInputError(str(error)) from None
    if node_id == UNCONFIGURED and not device.node.has_lss:
        raise UnusableInputError(f"--node {node_id}: {eds} says LSS_Supported=0, so its node id is fixed: must be 1 to 127")
    with opened_bus(bus_url, STANDARD_BITRATE) as bus:
        run_device(bus, device, lambda: on_ready({"ready": str(eds), "bus": bus_url, "node": node_id}))


@contextmanager
def opened_bus(url: str, bitrate: int) -> Iterator[can.BusABC]:
    """Open a bus for the length of the block."""
    bus = open_bus(url, bitrate)
    try:
        yield bus
    finally:
        bus.shutdown()
