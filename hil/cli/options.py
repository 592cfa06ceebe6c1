"""Options that several commands share, and how their text becomes SI."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.errors import ExperimentError, UnusableInputError
from hil.files.aside import keep_earlier as keep_earlier
from hil.files.writable import can_be_written as can_be_written
from hil.files.writable import folder_can_be_written as folder_can_be_written
from hil.files.writable import not_an_input as not_an_input
from hil.verbs.identify import OverAxis
from hil.verbs.verb import EFFECTS, POSE, SCAN

if TYPE_CHECKING:
    from hil.machine import Machine
    from virtual_bus.faults.fault import FaultSetting
    from virtual_bus.quirks.quirk import QuirkSetting

POSE_UNITS = {"deg": math.pi / 180.0, "m": 1.0}
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
ScanArgument = Annotated[Path, typer.Argument(metavar="SCAN", help=SCAN)]
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
EffectsOption = Annotated[Path | None, typer.Option("--effects", metavar="FILE", help=EFFECTS)]
FaultsOption = Annotated[
    Path | None, typer.Option("--faults", metavar="FILE", help="Faults file (TOML): what goes wrong, and when (isocenter faults list).")
]
QuirksOption = Annotated[
    list[str] | None,
    typer.Option("--quirk", metavar="DRIVE:NAME", help="This drive bends the standard so; once for each (isocenter faults quirks)."),
]
PoseOption = Annotated[str, typer.Option("--pose", metavar="AXIS=VALUE,...", help=POSE)]
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
    from hil.machine.effects_file import load_with_effects

    return load_with_effects(name, effects)


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
    return machine.units[machine.axis_index(axis)].edge


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


def parse_modes(option: str, text: str) -> tuple[int, ...]:
    """Read modes, counted from 1, such as `1,2`, as modes from 0."""
    try:
        return tuple(int(part) - 1 for part in text.split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(f"{option} {text}: must be mode numbers, such as 1,2") from None


def parse_point(option: str, text: str) -> tuple[float, float, float]:
    """Read `0,-12.5,3` in mm as a point [m].

    Raises
    ------
    UnusableInputError
        Not of that form.
    """
    try:
        x, y, z = (1e-3 * float(part) for part in text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise UnusableInputError(f"{option} {text}: must be three numbers in mm, such as 0,-12.5,3")
    return x, y, z


def parse_over_axis(option: str, text: str) -> OverAxis:
    """Read Q_n,Q_d,P and after it mirror@90deg, any number of them, and at most one period@360deg."""
    parts = text.split(",")
    found: dict[str, list[float]] = {"mirror": [], "period": []}
    numbers = _three_whole_numbers(option, ",".join(parts[:3]), "Q_n,Q_d,P, such as 1,1,2")
    for part in parts[3:]:
        kind, _, place = part.strip().partition("@")
        unit = next((unit for unit in POSE_UNITS if place.endswith(unit)), None)
        try:
            value = float(place.removesuffix(unit or "")) * POSE_UNITS[unit or ""]
            found[kind].append(value)
        except (KeyError, ValueError):
            raise typer.BadParameter(f"{option} {part}: must be mirror@90deg or period@360deg, in deg or m") from None
    if len(found["period"]) > 1:
        raise typer.BadParameter(f"{option}: one period at most")
    return OverAxis(*numbers, tuple(found["mirror"]), found["period"][0] if found["period"] else None)


def parse_orders(option: str, text: str) -> tuple[int, int, int]:
    """Read `2,2,1`."""
    return _three_whole_numbers(option, text, "N_n,N_m,N_d, such as 2,2,1")


def _three_whole_numbers(option: str, text: str, form: str) -> tuple[int, int, int]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3 or not all(part.isdecimal() for part in parts):
        raise typer.BadParameter(f"{option} {text}: must be three whole numbers {form}")
    first, second, third = map(int, parts)
    return first, second, third


FASTEST_Hz = 125.0
"""Exposures of the emulated panels take 8 ms."""
