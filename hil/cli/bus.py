"""isocenter scan-bus | home | move | stop: the nodes on a bus, the first careful motion, a way to a pose, and the end of any."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from hil.cli.attend import TellOption, opened, telling
from hil.cli.emulated import EMULATED
from hil.cli.options import BusOption, ImuOption, IoOption, MachineOption, load, parse_pose
from hil.terminal.output import Answer, JsonOption

if TYPE_CHECKING:
    from hil.machine import Machine


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(
        "scan-bus",
        short_help="Which nodes are on the bus.",
        help="Which nodes are on the bus, what they are, in which state. Its questions end a run there."
        "\n\nExample:  isocenter scan-bus --bus socketcan:vcan0",
    )(scan_bus)
    app.command(
        short_help="The first careful motion.",
        help="Brakes, first-move direction check, homing, encoder agreement; leaves the machine braked."
        "\n\nExample:  isocenter home --machine carm --bus socketcan:vcan0",
    )(home)
    app.command(
        short_help="Go to a pose.",
        help="Home, go to a pose, and close the brakes there; nothing is recorded. Drives in profile position mode go by themselves, others"
        " are led along a planned way.\n\nExample:  isocenter move --machine carm --bus socketcan:vcan0 --to roll=30",
    )(move)
    app.command(
        short_help="Stop what runs on a bus.",
        help="Stop the motors of the bench that runs on a bus, from any terminal, and stay until no drive has torque, or one holds its"
        " axis. Status 0: at rest or held; 1: not stopped, or nobody knows; 3: nothing runs there. No substitute for an emergency stop."
        "\n\nExample:  isocenter stop --bus socketcan:vcan0",
    )(stop)


def scan_bus(bus: BusOption, bitrate: int = typer.Option(1_000_000, help="Bit rate [bit/s]."), json_to: JsonOption = None) -> None:
    """Print one line per node."""
    from drivers.bus_url import open_bus
    from drivers.canopen.scan import scan_bus as scan
    from hil.bench.clock import WallClock
    from hil.errors import BadAnswerError

    answer = Answer(json_to)
    with open_bus(bus, bitrate) as wire:
        nodes = scan(wire, WallClock())
    for node in nodes:
        answer.say(str(node))
    answer.write({"bus": bus, "nodes": [vars(node) for node in nodes]})
    if not nodes:
        raise BadAnswerError(f"{bus}: nobody answers; is the machine on, or `isocenter emulate` ready, at {bitrate} bit/s?")


def home(
    machine_name: MachineOption,
    bus: BusOption,
    imu: ImuOption = "",
    io: IoOption = "",
    tell: TellOption = False,
    json_to: JsonOption = None,
) -> None:
    """Say what was checked, axis by axis."""
    from hil.bench.options import BenchOptions

    machine = load(machine_name)
    answer = Answer(json_to)
    with opened(machine, BenchOptions(bus, imu, io)) as bench, telling(bench, tell):
        report, judged = bench.commission(), bench.judged
        emulated = bench.emulated
    _say_where(machine, bus, emulated, answer)
    for line in report:
        answer.say(line)
    answer.write({"machine": machine.name, "bus": bus, "emulated": emulated, "checks": report, "judged": judged})
    _refuse_judged(judged, answer)


def move(
    machine_name: MachineOption,
    bus: BusOption,
    to: Annotated[
        str,
        typer.Option("--to", metavar="AXIS=VALUE,...", help="The pose, in degrees (mm on a prismatic axis); axes left out stay."),
    ],
    imu: ImuOption = "",
    io: IoOption = "",
    json_to: JsonOption = None,
) -> None:
    """Say where each axis stands."""
    from hil.bench.options import BenchOptions

    machine = load(machine_name)
    goal = parse_pose(to, machine, "--to")
    answer = Answer(json_to)
    with opened(machine, BenchOptions(bus, imu, io)) as bench:
        pose = bench.pose.copy()
        for axis, value in goal.items():
            pose[machine.axis_index(axis)] = value
        reached = dict(zip(machine.axes, bench.move(pose).tolist(), strict=True))
        notes, judged, emulated = bench.wiring.link.remarks, bench.judged, bench.emulated
    _say_where(machine, bus, emulated, answer)
    for note in notes:
        answer.say(note)
    for units in machine.units:
        answer.say(f"{units.axis}: at {reached[units.axis]:+.5f} {units.position}, brakes closed")
    found = {"checks": bench.commissioning, "notes": notes, "judged": judged}
    answer.write({"machine": machine.name, "bus": bus, "emulated": emulated, "position": reached, **found})
    _refuse_judged(judged, answer)


def _say_where(machine: Machine, bus: str, emulated: bool, answer: Answer) -> None:
    """Say which machine it was, in the first line where it was no real one."""
    if emulated:
        answer.say(f"{EMULATED}{machine.name} on {bus}")


def _refuse_judged(judged: Sequence[str], answer: Answer) -> None:
    """Say which sensors are not to be believed, and leave with exit status 1 where there are any."""
    if judged:
        answer.say(f"sensors not to be believed: {'; '.join(judged)}")
        raise typer.Exit(1)


def stop(bus: BusOption, json_to: JsonOption = None) -> None:
    """Say what the supervisor sees."""
    from hil.cli.stop import stop_at_once

    raise typer.Exit(stop_at_once(bus, json_to))
