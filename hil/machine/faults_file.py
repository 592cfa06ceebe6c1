"""Faults files (TOML): faults of the emulated machine, by name, place and time.

[[fault]]
name = "brake_stays_open"
at = "roll"
when = "abs(speed_roll) > 0.3"
for_s = 0.5
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hil.errors import MachineFileError
from hil.machine.load import parse_toml, read_text
from hil.machine.machine import Machine
from virtual_bus.errors import FaultError
from virtual_bus.faults.binding import FaultPlaces, as_entries, bind_faults
from virtual_bus.faults.fault import FaultSetting

KEYS = ("format", "fault")
FRAME_BITS = 64  # of data, at most


def read_faults_file(path: str | Path, machine: Machine) -> tuple[FaultSetting, ...]:
    """Faults of a file, bound to the places of a machine.

    Raises
    ------
    MachineFileError
        One line: the file, which fault, what is wrong and what would be right.
    """
    file = Path(path)
    return faults_from_text(read_text(file, "give the path of a faults file"), machine, str(file))


def faults_from_text(text: str, machine: Machine, label: str) -> tuple[FaultSetting, ...]:
    """Faults from the text of a faults file; `label` is what messages call it."""
    raw = parse_toml(text, label)
    for key in raw:
        if key not in KEYS:
            raise MachineFileError(f"{label}: {key!r}: unknown key; a faults file holds [[fault]] tables")
    if raw.get("format", 1) != 1:
        raise MachineFileError(f"{label}: format = {raw['format']!r}: this version reads format 1")
    entries = raw.get("fault", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise MachineFileError(f"{label}: fault: must be tables; write [[fault]] above each")
    try:
        return bind_faults(entries, places_of(machine), label)
    except FaultError as error:
        raise MachineFileError(" ".join(str(error).split())) from None


def faults_text(faults: Sequence[FaultSetting]) -> str:
    """Text of a faults file: the inverse of `faults_from_text`."""
    lines = ["format = 1"]
    for entry in as_entries(faults):
        lines += ["", "[[fault]]"]
        lines += [f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}" for key, value in entry.items()]
    return "\n".join(lines) + "\n"


def places_of(machine: Machine) -> FaultPlaces:
    """Return where faults may act on a machine.

    Raises
    ------
    MachineFileError
        The machine has no bus, so it cannot be emulated.
    """
    bus = machine.bus
    if bus is None:
        raise MachineFileError(f"{machine.name}: its file has no [bus]; there is nothing to emulate on a wire, and no fault")
    io = bus.io
    with_effort = {joint.name for joint in machine.plant.tree.joints if joint.brake_effort > 0.0}
    braked = tuple(
        drive.axis for drive in machine.plant.drives if drive.joint in with_effort and (io is None or drive.axis in io.brake_coils)
    )
    encoders = [sensor.channel for sensor in machine.plant.encoders if sensor.channel.startswith("link_position_")]
    return FaultPlaces(
        axes=machine.axes,
        braked=braked,
        watched=tuple(axis for axis in machine.axes if io is not None and axis in io.brake_feedback_inputs and axis in braked),
        thermometers=tuple(axis for axis in machine.axes if io is not None and axis in io.temperature_registers),
        linked=tuple(channel.removeprefix("link_position_") for channel in encoders),
        drives=tuple(node.name for node in bus.nodes if node.role == "drive"),
        encoders=tuple(node.name for node in bus.nodes if node.role == "encoder"),
        short=tuple(node.name for node in bus.nodes if any(sum(bits for *_, bits in pdo.entries) < FRAME_BITS for pdo in node.tpdos)),
        imu=bus.imu is not None,
        io=io is not None,
        producer=(bus.sync_producer,) if bus.sync_producer else (),
    )
