"""Reading a machine file: TOML text to a checked `Machine`, and every error in one line."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hil.errors import MachineFileError
from hil.files.regular import check_regular
from hil.machine.build import build_geometry, build_limits, build_plant, build_units
from hil.machine.build_budgets import brake_delays, build_budgets, quick_stops
from hil.machine.build_bus import build_bus
from hil.machine.build_control import build_commands, build_controllers, build_drive_loops
from hil.machine.build_judging import build_judging
from hil.machine.editors import without_schema_line
from hil.machine.machine import Machine
from hil.machine.messages import ComplaintError, from_validation, one_line
from hil.machine.open_points import marks
from hil.machine.schema import MachineTable
from hil.machine.table import is_name

SHIPPED = Path(__file__).resolve().parent / "shipped"


def list_shipped() -> dict[str, str]:
    """Name and description of every machine that comes with the project.

    Examples
    --------
    >>> import hil
    >>> hil.list_shipped()["turntable"]
    'A turntable on one drive, at 200 Hz'
    """
    return {path.stem: load_machine(path).description for path in sorted(SHIPPED.glob("*.toml"), key=lambda path: path.stem)}


def load_machine(name_or_path: str | Path) -> Machine:
    """Read a machine by its shipped name (`carm`, `emps`) or by the path of a machine file.

    Raises
    ------
    MachineFileError
        One line: file, key, value, what is wrong and what would be right.
    """
    path = _path(name_or_path)
    return machine_from_text(text_of(path), path)


def text_of(name_or_path: str | Path) -> str:
    """Return the text of a machine file, unread.

    Raises
    ------
    MachineFileError
        It cannot be read.
    """
    shipped = ", ".join(sorted(entry.stem for entry in SHIPPED.glob("*.toml")))
    return read_text(_path(name_or_path), f"give a machine file's path or a shipped name: {shipped}")


def name_to_load(machine: Machine) -> str:
    """Return what `load_machine` and the command line take for a machine: its shipped name, or the path of its file."""
    if machine.path is None:
        return name_of_recorded(machine.name, machine.hash)
    return machine.path.stem if machine.path.parent == SHIPPED else str(machine.path)


def name_of_recorded(name: str, its_hash: str) -> str:
    """Return what the command line takes for a machine that a recording names: a shipped name, or MACHINE.toml for a file elsewhere."""
    path = SHIPPED / f"{name}.toml"
    is_shipped = is_name(name) and path.is_file() and _hash(read_text(path, "")) == its_hash
    return name if is_shipped else "MACHINE.toml"


def _hash(text: str) -> str:
    return hashlib.sha256(without_schema_line(text).encode("utf-8")).hexdigest()


def _path(name_or_path: str | Path) -> Path:
    path = SHIPPED / f"{name_or_path}.toml"
    is_shipped = isinstance(name_or_path, str) and is_name(name_or_path) and path.is_file()
    return path if is_shipped else Path(name_or_path)


def machine_from_text(text: str, path: Path | None = None, label: str = "") -> Machine:
    """Read a machine from the text of its file, as recordings keep it.

    Parameters
    ----------
    text
        TOML text of a machine file.
    path
        Where the text was read; EDS files named in it are looked for beside it first.
    label
        How messages call the file when it has no path.

    Raises
    ------
    MachineFileError
        One line: file, key, value, what is wrong and what would be right.
    """
    file = str(path) if path is not None else label or "machine file"
    raw = parse_toml(text, file)
    try:
        table = MachineTable.model_validate(raw)
        plant = build_plant(table)
        units, limits, geometry = build_units(table, plant.tree), build_limits(table, plant.tree), build_geometry(table)
        commands = build_commands(table, limits)
        controllers = build_controllers(table, commands)
        bus = build_bus(table, plant, None if path is None else path.parent)
        return Machine(
            name=table.name,
            description=table.description,
            text=text,
            hash=_hash(text),
            path=path,
            axes=tuple(table.drives),
            sample_rate_Hz=table.timing.sample_rate,
            waits_on_overrun=table.timing.overrun == "wait",
            overrun_ticks=table.timing.overrun_ticks,
            stale_ticks=table.timing.stale_ticks,
            needs_recorder=table.timing.recorder_stalls == "stop",
            units=units,
            plant=plant,
            controllers=controllers,
            commands=commands,
            drive_loops=build_drive_loops(table),
            limits=limits,
            geometry=geometry,
            bus=bus,
            budgets=build_budgets(table, plant.tree),
            brake_delay_s=brake_delays(table),
            quick_stop=quick_stops(table),
            judging=build_judging(table, plant, bus),
            own_effects=plant.effects,
        )
    except ValidationError as error:
        raise MachineFileError(_open_points(text, file) or one_line(file, raw, from_validation(error))) from None
    except ComplaintError as complaint:
        raise MachineFileError(_open_points(text, file) or one_line(file, raw, complaint)) from None


def _open_points(text: str, file: str) -> str:
    """Return what is wrong with a file that is not filled in yet."""
    missing, _ = marks(text)
    if not missing:
        return ""
    first = missing[0]
    words = f"{first.key} is to be filled in (one of {len(missing)} open points; `isocenter machine check` lists them)"
    return f"{file}: line {first.line}: {words}"


def read_text(path: Path, right: str) -> str:
    """Text of a file; `right` is what to do where there is none."""
    check_regular(path, MachineFileError)
    try:
        return path.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise MachineFileError(f"{path}: byte {error.start} is no UTF-8; TOML files are UTF-8 text") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null byte
        reason = getattr(error, "strerror", None) or "cannot be read"
        raise MachineFileError(" ".join(f"{path}: {reason}; {right}".split())) from None


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """TOML text to a dictionary; a syntax error names its line in one line."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = " ".join(str(error).split())
        raise MachineFileError(f"{file}: no valid TOML: {message}") from None
    except (ValueError, RecursionError) as error:  # digits beyond Python's limit; brackets nested too deep
        reason = "nested too deep" if isinstance(error, RecursionError) else "a number has too many digits"
        raise MachineFileError(f"{file}: no valid TOML: {reason}") from None
