"""Options that several commands share, and how their text becomes SI."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.errors import ExperimentError, UnusableInputError
from hil.files.aside import keep_earlier as keep_earlier
from hil.terminal.output import refuse_unwritable, refuse_unwritable_folder

if TYPE_CHECKING:
    from hil.machine import Machine
    from virtual_bus.faults.fault import FaultSetting
    from virtual_bus.quirks.quirk import QuirkSetting
    from virtual_bus.settings import EffectSetting

SHIPPED = Path(__file__).resolve().parents[1] / "machine" / "shipped"


def shipped_names(incomplete: str) -> list[str]:
    """Return the shipped machines for a shell to complete; where none fits it completes paths."""
    return sorted(path.stem for path in SHIPPED.glob(f"{incomplete}*.toml"))


MachineOption = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        metavar="M",
        help="Machine file, or the name of a shipped one (isocenter machine list).",
        autocompletion=shipped_names,
    ),
]
ScanArgument = Annotated[
    Path, typer.Argument(metavar="SCAN", help="Folder of a scan: its images, when they were exposed, and the panel's description.")
]
MachineArgument = Annotated[
    str,
    typer.Argument(metavar="M", help="Machine file, or the name of a shipped one (isocenter machine list).", autocompletion=shipped_names),
]
BusOption = Annotated[
    str,
    typer.Option(
        "--bus",
        "-b",
        metavar="URL",
        help="lockstep:, virtual:NAME, socketcan:vcan0, udp:GROUP, slcan:/dev/ttyACM0@1000000 or any INTERFACE:CHANNEL of python-can.",
    ),
]
EffectsOption = Annotated[Path | None, typer.Option("--effects", metavar="FILE", help="Effects file (TOML): physics added by name.")]
FaultsOption = Annotated[
    Path | None, typer.Option("--faults", metavar="FILE", help="Faults file (TOML): what goes wrong, and when (isocenter faults list).")
]
QuirksOption = Annotated[
    list[str] | None,
    typer.Option("--quirk", metavar="DRIVE:NAME", help="This drive bends the standard so; once for each (isocenter faults quirks)."),
]
PoseOption = Annotated[
    str, typer.Option("--pose", metavar="AXIS=VALUE,...", help="Start pose, in degrees (mm on a prismatic axis); axes left out stand at 0.")
]
ImuOption = Annotated[
    str, typer.Option("--imu", metavar="DEVICE", help="Serial device of the IMU, or tcp:HOST:PORT, where the machine file names none.")
]
IoOption = Annotated[
    str,
    typer.Option(
        "--io", metavar="URL", help="tcp:HOST:PORT, rtu:DEVICE@BAUD or rtu:DEVICE@BAUD,8N1 of the I/O, where the file names none."
    ),
]
RealTimeOption = Annotated[
    bool, typer.Option("--real-time/--no-real-time", help="Ask for real-time scheduling; not where loop and emulator share one processor.")
]
NominalPeriodOption = Annotated[float, typer.Option("--period", metavar="S", help="Base period; lines are its inverse apart.")]


def load(name: str, effects: Path | None = None) -> Machine:
    """Load a machine, with an effects file's physics added."""
    from hil.machine import load_machine

    machine = load_machine(name)
    return machine.with_effects(read_effects(effects, machine)) if effects is not None else machine


def read_effects(path: Path, machine: Machine) -> tuple[EffectSetting, ...]:
    """Read the effects of a file, checked against the catalogue and the machine."""
    from hil.machine.effects_file import read_effects_file

    return read_effects_file(path, machine)


def read_faults(path: Path | None, machine: Machine, lockstep: bool) -> tuple[FaultSetting, ...]:
    """Read the faults of a file, checked against the list of faults and the machine; without a file there are none.

    Raises
    ------
    UnusableInputError
        A fault waits for rows to be recorded, of which an emulator on a bus does not know.
    """
    from hil.machine.faults_file import read_faults_file

    faults = () if path is None else read_faults_file(path, machine)
    for fault in faults:
        if not lockstep and str(fault.when).startswith("recording"):
            raise UnusableInputError(
                f'{path}: {fault.label}: when = "{fault.when}": only a run on lockstep: knows; name a motion, such as "settled"'
            )
    return faults


def read_quirks(texts: list[str] | None, machine: Machine) -> tuple[QuirkSetting, ...]:
    """Read the quirks of an emulated machine's drives.

    Raises
    ------
    FaultError
        No such drive or quirk.
    """
    if not texts:
        return ()
    from hil.machine.faults_file import places_of
    from virtual_bus.quirks.registry import parse_quirks

    return parse_quirks(texts, places_of(machine).drives)


def edge_scale(machine: Machine, axis: str) -> float:
    """Return one unit of the command line in SI: a degree, or a millimetre on a prismatic axis."""
    return math.pi / 180.0 if machine.units[machine.axis_index(axis)].position == "rad" else 1e-3


def parse_pose(text: str, machine: Machine, option: str = "--pose") -> dict[str, float]:
    """Read `roll=30,propeller=-10` in rad (or m).

    Raises
    ------
    ExperimentError
        Not of that form, no such axis, or one twice.
    """
    pose = {}
    for part in filter(None, text.split(",")):
        axis, equals, number = part.partition("=")
        axis = axis.strip()
        try:
            value = float(number)
        except ValueError:
            equals = ""
            value = math.nan
        if not equals or not math.isfinite(value):
            raise ExperimentError(f"{option} {text}: {part!r} is not AXIS=NUMBER, such as roll=30")
        if axis not in machine.axes:
            raise ExperimentError(f"{option} {text}: {machine.name} has no axis {axis!r}; it has {', '.join(machine.axes)}")
        if axis in pose:
            raise ExperimentError(f"{option} {text}: {axis} stands in it twice; say where it is once")
        pose[axis] = value * edge_scale(machine, axis)
    return pose


def parse_band(option: str, text: str) -> tuple[float, float]:
    """Read `0.5:40` as (low, high) [Hz].

    Raises
    ------
    UnusableInputError
        Not of that form, or not ascending.
    """
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = math.nan
    if not -math.inf < low < high < math.inf:
        raise UnusableInputError(f"{option} {text}: must be LOW:HIGH in Hz, ascending, such as 0.5:40")
    return low, high


def parse_whole_numbers(option: str, text: str) -> tuple[int, ...]:
    """Read `1,3,5`, each from 1.

    Raises
    ------
    UnusableInputError
        Not of that form.
    """
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = (0,)
    if min(numbers) < 1:
        raise UnusableInputError(f"{option} {text}: must be whole numbers from 1, such as 1,3,5")
    return numbers


def not_an_input(out: Path, *inputs: Path) -> None:
    """Refuse to write over an input.

    Raises
    ------
    UnusableInputError
        `out` is one of the inputs.
    """
    for path in inputs:
        if out.exists() and path.exists() and out.samefile(path):
            raise UnusableInputError(f"{out}: is read by this command; write to another file")


def can_be_written(*paths: Path | None, suffixes: tuple[str, ...] = ()) -> None:
    """Refuse a place that cannot be written to before the work is done, not after.

    Raises
    ------
    UnusableInputError
        The folder does not exist or cannot be written to, the path is a folder, or its suffix is none of `suffixes`.
    """
    for path in paths:
        if path is None:
            continue
        refuse_unwritable(path, str(path))
        if suffixes and path.suffix.lower() not in suffixes:
            raise UnusableInputError(f"{path}: must end in {', '.join(suffixes)}")


def folder_can_be_written(folder: Path) -> None:
    """Refuse a folder that cannot be written to; it is made when there is something to put into it.

    Raises
    ------
    UnusableInputError
        It is a file or lies in one, or cannot be written to.
    """
    nearest = next(there for there in (folder.absolute(), *folder.absolute().parents) if there.exists())
    if not nearest.is_dir():
        raise UnusableInputError(f"{folder if nearest == folder.absolute() else nearest}: is a file; give a folder for the answer")
    refuse_unwritable_folder(nearest, str(folder))


FASTEST_Hz = 125.0
"""Exposures of the emulated panels take 8 ms."""
