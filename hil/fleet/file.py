"""The file of a fleet (TOML): its machines, where their recordings lie, which are repeats or held out, and what to do with them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from hil.errors import UnusableInputError
from hil.files.regular import check_regular
from hil.fleet.job import Needs
from hil.machine.messages import ComplaintError, from_validation, one_line
from hil.machine.table import Positive, Table, Text, Whole

TaskName = Literal["check", "identify", "friction", "diagnose", "calibrate"]
When = Literal["differs", "changed", "always"]
Texts = tuple[Text, ...]

NEEDS: Mapping[TaskName, Needs] = {
    "check": Needs(memory_GB=2.0, threads=1, time_s=300.0),
    "identify": Needs(memory_GB=2.0, threads=1, time_s=600.0),
    "friction": Needs(memory_GB=4.0, threads=1, time_s=600.0),
    "diagnose": Needs(memory_GB=4.0, threads=1, time_s=1800.0),
    "calibrate": Needs(memory_GB=4.0, threads=1, time_s=1800.0),
}
"""What a task may take unless the file says otherwise: with room above what recordings of a minute take."""

STORE = "fleet-results"
"""Folder of the results beside the file, unless it names another one."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


class LimitTable(Table):
    """Table `[limits.TASK]`: what a task may take at most."""

    memory_GB: Positive | None = None
    """Resident memory."""
    threads: Annotated[Whole, Field(ge=1, le=64)] | None = None
    """Threads; the answer does not depend on them."""
    time_s: Positive | None = None
    """Time on the wall clock."""


class LimitsTable(Table):
    """Table `[limits]`."""

    check: LimitTable = LimitTable()
    identify: LimitTable = LimitTable()
    friction: LimitTable = LimitTable()
    diagnose: LimitTable = LimitTable()
    calibrate: LimitTable = LimitTable()


class EveryTable(Table):
    """Table `[every]`: keys of all machines that do not say otherwise."""

    file: Text | None = None
    """Machine file: a shipped name, or a path from the fleet file."""
    recordings: Text | None = None
    """Folder or pattern of recordings: a path from the fleet file, or a URL that fsspec reads; `{name}` is the machine's name."""
    repeats: Texts = ()
    """Experiments to explain, as patterns of recordings' names without suffix; all recordings of a night and pattern are its repeats."""
    held_out: Texts = ()
    """Experiments to judge a diagnosis by."""
    identified: Texts | None = None
    """Experiments whose frequency response is identified; the repeats unless given."""
    tasks: tuple[TaskName, ...] = ("check",)
    """What to do with each night's recordings."""
    diagnose_when: When = "differs"
    """`"differs"`: where a check of the night differs from the simulation; `"changed"`: on the night on which `fleet change` first names
    the machine; `"always"`."""


class MachineEntry(EveryTable):
    """Table `[[machine]]`."""

    name: Text
    """Letters, digits, `.`, `_` and `-`."""


class FleetTable(Table):
    """The file."""

    format: Literal[1]
    store: Text = STORE
    """Folder of the results, from the fleet file."""
    every: EveryTable = EveryTable()
    limits: LimitsTable = LimitsTable()
    machine: tuple[MachineEntry, ...]


@dataclass(frozen=True)
class FleetMachine:
    """A machine of a fleet: what its table and `[every]` say, paths resolved."""

    name: str
    file: str
    recordings: str
    repeats: tuple[str, ...]
    held_out: tuple[str, ...]
    identified: tuple[str, ...]
    tasks: tuple[TaskName, ...]
    diagnose_when: When


@dataclass(frozen=True)
class Fleet:
    """A fleet, read and checked; made by `read_fleet`."""

    path: Path
    store: Path
    machines: tuple[FleetMachine, ...]
    needs: Mapping[TaskName, Needs]


def read_fleet(path: str | Path) -> Fleet:
    """Read the file of a fleet.

    Raises
    ------
    UnusableInputError
        One line: file, key, value, what is wrong and what would be right.
    """
    path = Path(path)
    check_regular(path)
    try:
        raw = tomllib.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        raise UnusableInputError(f"{path}: {error.strerror}; give the file of a fleet") from None
    except (ValueError, RecursionError) as error:  # no UTF-8, no TOML, nested too deep
        raise UnusableInputError(f"{path}: no valid TOML: {' '.join(str(error).split())}") from None
    try:
        return _fleet(FleetTable.model_validate(raw), path)
    except ValidationError as error:
        raise UnusableInputError(one_line(str(path), raw, from_validation(error))) from None
    except ComplaintError as complaint:
        raise UnusableInputError(one_line(str(path), raw, complaint)) from None


def _fleet(table: FleetTable, path: Path) -> Fleet:
    names = [entry.name for entry in table.machine]
    for place, name in enumerate(names):
        if not _NAME.fullmatch(name):
            raise ComplaintError(("machine", place, "name"), "must be letters, digits, `.`, `_` and `-`: it names a folder")
        if name in names[:place]:
            raise ComplaintError(("machine", place, "name"), "is the name of an earlier machine; each has its own")
    if not names:
        raise ComplaintError(("machine",), "a fleet has one machine at least: write [[machine]] with a name")
    needs = {name: _needs(NEEDS[name], getattr(table.limits, name)) for name in NEEDS}
    machines = tuple(_machine(place, entry, table.every, path.parent) for place, entry in enumerate(table.machine))
    return Fleet(path, path.parent / table.store, machines, needs)


def _needs(usual: Needs, limit: LimitTable) -> Needs:
    return Needs(limit.memory_GB or usual.memory_GB, limit.threads or usual.threads, limit.time_s or usual.time_s)


def _machine(place: int, entry: MachineEntry, every: EveryTable, folder: Path) -> FleetMachine:
    said = {name: getattr(entry if entry.has(name) else every, name) for name in EveryTable.model_fields}
    for key in ("file", "recordings"):
        if said[key] is None:
            raise ComplaintError(("machine", place), f"needs `{key}`, here or in [every]")
    file, recordings = said.pop("file"), said.pop("recordings").replace("{name}", entry.name)
    identified = said.pop("identified")
    if not (file.isidentifier() or Path(file).is_absolute()):
        file = str(folder / file)
    if "://" not in recordings:
        recordings = str((folder / recordings).absolute())
    if explained := [task for task in ("friction", "diagnose") if task in said["tasks"] and not said["repeats"]]:
        raise ComplaintError(("machine", place), f'has the task "{explained[0]}", so it needs `repeats`, such as repeats = ["scan_*"]')
    return FleetMachine(entry.name, file, recordings, identified=said["repeats"] if identified is None else identified, **said)
