"""isocenter effects | emulate: the physics there is, and the emulated machine on a bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import BusOption, EffectsOption, PoseOption, RealTimeOption, load, parse_pose
from hil.cli.output import Answer


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(
        short_help="The catalogue of physics.",
        help="The catalogue of physics: names, equations, parameters with units and bounds, where each may act."
        "\n\nExample:  isocenter effects --json effects.json",
    )(effects)
    app.command(
        short_help="The emulated machine on a bus.",
        help="The emulated machine on a bus, wall clock; or one bare CANopen device of any EDS."
        "\n\nExample:  isocenter emulate carm --bus socketcan:vcan0"
        "\n\nExample:  isocenter emulate --eds device.eds --node 5 --bus socketcan:vcan0",
    )(emulate)


def effects(
    json_to: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Write the answer as JSON to FILE; - for standard output."),
    ] = None,
) -> None:
    """Print the catalogue."""
    from virtual_bus.effects import catalogue

    answer = Answer(json_to)
    entries = catalogue()
    for entry in entries:
        parameters = ", ".join(f"{p['name']} [{p['unit']}]" for p in entry["parameters"])
        answer.say(f"{entry['name']:28s} {parameters}")
    answer.write(entries)


def emulate(
    machine_name: Annotated[str | None, typer.Argument(metavar="[M]", help="Machine file, or the name of a shipped one.")] = None,
    bus: BusOption = "socketcan:vcan0",
    eds: Annotated[Path | None, typer.Option("--eds", metavar="FILE", help="Emulate one bare CiA 301 device of this EDS instead.")] = None,
    node: Annotated[int, typer.Option("--node", metavar="N", help="Its node id.")] = 1,
    effects_file: EffectsOption = None,
    pose: PoseOption = "",
    truth: Annotated[Path | None, typer.Option("--truth", metavar="FILE", help="Write what only the emulator knows (.csv).")] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the sensors' noise.")] = 0,
    noise: Annotated[bool, typer.Option("--noise/--no-noise", help="The sensors' noise.")] = True,
    real_time: RealTimeOption = True,
) -> None:
    """Run until interrupted."""
    from hil.emulation import emulate_eds, emulate_machine

    if (eds is None) == (machine_name is None):
        raise typer.BadParameter("give either a machine M or --eds FILE")
    if eds is not None:
        emulate_eds(eds, node, bus)
        return
    assert machine_name is not None
    machine = load(machine_name, effects_file)
    emulate_machine(machine, bus, parse_pose(pose, machine), seed=seed, noise=noise, truth=truth, punctual=real_time)
